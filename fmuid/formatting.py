"""Text for people: numbers rounded to their σ, units, lists, similar names.

Some text comes from untrusted files: terminals execute control characters, and invisible characters disguise names
(CWE-150, CVE-2021-42574).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence

# All control characters except tab and line feed; line separators, invisible joiners, marks of writing direction and
# surrogates (Unicode 16, categories Cc, Cf, Zl, Zp and Cs).
_INVISIBLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)

_ELEMENT = re.compile(r".+\[\d+(,\d+)*\]")


def of_one_experiment(name: str) -> bool:
    """Return whether a parameter belongs to one experiment: ``R[cold]``, not ``A[1,2]``."""
    return name.endswith("]") and _ELEMENT.fullmatch(name) is None


def of_parameter(name: str, parameter: str) -> bool:
    """Return whether a name is a parameter's, or as ``R[cold]`` of ``R``."""
    return name == parameter or name.startswith(f"{parameter}[")


def visible(text: str) -> str:
    """Return a text without control characters and invisible characters."""
    return text if text.isprintable() else _INVISIBLE.sub("", text)


def bounded(text: str, length: int) -> str:
    """Return a text in one visible line, cut to `length` characters."""
    if len(text) <= length and text.isprintable():
        return text
    line = " ".join(visible(text[: 2 * length]).split())
    return line if len(line) <= length and len(text) <= 2 * length else line[: length - 1] + "…"


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `` (did you mean 'a' or 'b'?)``, or nothing."""
    names = list(known)
    found = difflib.get_close_matches(name, names, cutoff=0.5)
    if not found:
        folded = {known_name.lower(): known_name for known_name in names}
        found = [folded[f] for f in difflib.get_close_matches(name.lower(), folded, cutoff=0.5)]
    return f" (did you mean {' or '.join(repr(f) for f in found)}?)" if found else ""


def listed(words: Sequence[str]) -> str:
    """Return ``a, b and c``, "" of nothing."""
    return "".join(words) if len(words) < 2 else f"{', '.join(words[:-1])} and {words[-1]}"


def counted(number: int, noun: str) -> str:
    """Return a number of things: ``1 sample``, ``2 samples``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def rounded(value: float, std: float) -> str:
    """Return a value to two digits of σ, or six digits."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    if -3 < decimals < 10:
        return f"{value:.{max(0, decimals)}f}"
    size = max(abs(value), std)  # otherwise too many zeros
    kept = round(value, decimals)
    return f"{kept:.{max(1, math.floor(math.log10(size)) + decimals)}e}" if kept else "0"


def with_std(value: float, std: float) -> str:
    """Return ``value ± std``, or the value alone without σ."""
    shown = rounded(value, std)
    return f"{shown} ± {rounded(std, std)}" if math.isfinite(std) and std > 0 else shown


def has_unit(unit: str | None) -> bool:
    """Return whether a unit is written: not missing, and not FMI's "1"."""
    return unit not in (None, "", "1")


def unit_text(unit: str | None) -> str:
    """Return the unit for a cell of a table."""
    return unit if unit is not None and has_unit(unit) else ""


def with_unit(value: float, unit: str | None) -> str:
    """Return a number with its unit."""
    return f"{value:.4g} {unit}" if has_unit(unit) else f"{value:.4g}"


def two_digits(value: float) -> str:
    """Return a number to two digits, without exponent below a million."""
    return f"{value:.0f}" if 99.5 <= abs(value) < 1e6 else f"{value:.2g}"


def fit_text(fit: float | None) -> str:
    """Return a fit in %, or a dash for NaN."""
    return "–" if fit is None or math.isnan(fit) else f"{fit:.4g} %"


def label(name: str, unit: str | None) -> str:
    """Return the label of an axis or column: name and unit."""
    return f"{name} ({unit})" if has_unit(unit) else name
