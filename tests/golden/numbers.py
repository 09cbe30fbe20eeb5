"""Numbers of runs, kept in a file by `repr` and compared.

    python -m tests.golden.numbers record FILE [NAME...]     # runs them and writes their numbers
    python -m tests.golden.numbers compare FILE [NAME...]    # runs them again: the same to the last bit, on one machine

NAME: the beginning of the names of runs; default: all.
"""

import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from tests.golden.runs import DATA, RECORDED, RUNS, TOLERANCES, Numbers

Kept = dict[str, Numbers]


def load(path: Path) -> Kept:
    """Return the kept numbers, by run and name."""
    found: Kept = json.loads(path.read_text(encoding="utf-8"))
    return found


def save(kept: Kept, path: Path) -> None:
    """Write numbers, one a line."""
    path.write_text(json.dumps(kept, indent=0, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")


def run(names: list[str]) -> Kept:
    """Run all, or those whose names begin so."""
    chosen = [name for name in RUNS if not names or name.startswith(tuple(names))]
    kept: Kept = {}
    for name in chosen:
        if name in RECORDED and not DATA.is_dir():
            continue
        began = time.process_time()
        kept[name] = RUNS[name]()
        print(f"{name}: {time.process_time() - began:.1f} s of CPU", file=sys.stderr, flush=True)
    return kept


def differences(found: Numbers, kept: Numbers, *, exact: bool = False) -> list[str]:
    """Return which numbers differ: by more than their tolerance, or at all."""
    if found.keys() != kept.keys():
        return [f"other names: {sorted(found.keys() ^ kept.keys())}"]
    return [
        f"{name}: {found[name]!r}, kept {expected!r}"
        for name, expected in kept.items()
        if not _agree(name, found[name], kept, exact)
    ]


def _agree(name: str, found: float | str, kept: Mapping[str, float | str], exact: bool) -> bool:
    expected = kept[name]
    if isinstance(expected, str) or isinstance(found, str):
        return found == expected
    if found == expected or (math.isnan(found) and math.isnan(expected)):
        return True
    return not exact and abs(found - expected) <= _allowed(name, kept)


def _allowed(name: str, kept: Mapping[str, float | str]) -> float:
    kind, _, rest = name.partition(".")
    size = kept[f"std.{rest}"] if kind == "value" else kept[name]
    scale = {"cost": 1.0, "time": 1.0, "count": 1.0, "statistic": 1.0 + abs(float(size))}
    return TOLERANCES[kind] * scale.get(kind, abs(float(size)))


def main() -> None:
    """Do what the command line says."""
    match sys.argv[1:]:
        case ["record", file, *names]:
            save(run(names), Path(file))
        case ["compare", file, *names]:
            kept = load(Path(file))
            lines = [
                f"{name}: {each}"
                for name, found in run(names).items()
                for each in differences(found, kept[name], exact=True)
            ]
            print(*lines, f"{len(lines)} differences", sep="\n")
            sys.exit(bool(lines))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
