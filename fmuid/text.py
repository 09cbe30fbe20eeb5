"""Numbers and names as people read them: rounding to a standard deviation, units, lists, near names.

What is printed comes in part from files that nobody vouches for. A terminal obeys control characters, and characters
that are not seen or change the direction of writing make a name look like another one (CWE-150, CVE-2021-42574).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence

# All control characters but tab and line feed; what separates lines, joins letters unseen, orders them from right to
# left or is no character at all (Unicode 16, categories Cc, Cf, Zl, Zp and Cs).
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)


def visible(text: str) -> str:
    """Return a text without what a terminal obeys or a reader cannot see."""
    return text if text.isprintable() else _UNSEEN.sub("", text)


def bounded(text: str, length: int) -> str:
    """Return a text in one line, without what cannot be seen, and of no more letters than `length`."""
    if len(text) <= length and text.isprintable():
        return text
    line = " ".join(visible(text[: 2 * length]).split())
    return line if len(line) <= length and len(text) <= 2 * length else line[: length - 1] + "…"


def nearest(name: str, known: Iterable[str], count: int = 3) -> str:
    """Return `` (did you mean 'a' or 'b'?)``, or nothing where no known name is near."""
    names = list(known)
    found = difflib.get_close_matches(name, names, n=count, cutoff=0.5)
    if not found:
        folded = {known_name.lower(): known_name for known_name in names}
        found = [folded[f] for f in difflib.get_close_matches(name.lower(), folded, n=count, cutoff=0.5)]
    return f" (did you mean {' or '.join(repr(f) for f in found)}?)" if found else ""


def listed(words: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def rounded(value: float, std: float) -> str:
    """Return `value` to the second significant digit of its standard deviation, to six digits where it has none."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    if -3 < decimals < 10:
        return f"{value:.{max(0, decimals)}f}"
    size = max(abs(value), std)  # else too many zeros to read
    kept = round(value, decimals)
    return f"{kept:.{max(1, math.floor(math.log10(size)) + decimals)}e}" if kept else "0"


def with_std(value: float, std: float) -> str:
    """Return ``value ± std`` with two significant digits of the latter, `value` alone where there is none."""
    shown = rounded(value, std)
    return f"{shown} ± {rounded(std, std)}" if math.isfinite(std) and std > 0 else shown


def has_unit(unit: str | None) -> bool:
    """Return whether a unit is worth writing: neither missing nor FMI's "1" of what has none."""
    return unit not in (None, "", "1")


def label(name: str, unit: str | None) -> str:
    """Return the text of an axis or a table's head: name and unit."""
    return f"{name} ({unit})" if has_unit(unit) else name
