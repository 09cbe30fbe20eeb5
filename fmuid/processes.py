"""How processes that run Python are started: they import what this process would, and nothing that lies about."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# -E: no PYTHONPATH, PYTHONHOME, ...; -P: neither the current folder nor a script's. Processes that `multiprocessing`
# starts from such a process (Dask's workers) get the same.
_ALONE = ("-E", "-P")
# What a process can import by itself beside, such as packages that are developed in the current folder, comes last.
_BEGIN = (
    "import sys; sys.path[:] = dict.fromkeys([*{paths!r}, *sys.path]); "
    "from runpy import run_module; run_module({module!r}, run_name='__main__', alter_sys=True)"
)


def python_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as ``python -m`` does, which starts every process of ours.

    ``python -m`` would run files of the current folder that are named like modules, and so would an empty entry of
    ``PYTHONPATH``. The process searches for modules where this one does instead (`search_path`).

    Parameters
    ----------
    module : str
        Dotted name.
    arguments : str
        What it finds in ``sys.argv[1:]``.
    """
    flags = [*_ALONE, *(["-s"] if sys.flags.no_user_site else []), *(["-B"] if sys.dont_write_bytecode else [])]
    return [sys.executable, *flags, "-c", _BEGIN.format(paths=search_path(), module=module), *arguments]


def search_path() -> list[str]:
    """Return where this process searches for modules, and last where fmuid is.

    Left out are relative entries, the current folder and that of the script: what Python itself puts before all others.
    """
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    around = {_real(Path()), *([_real(Path(script).parent)] if script else [])}
    kept = [each for each in sys.path if Path(each).is_absolute() and _real(Path(each)) not in around]
    return list(dict.fromkeys([*kept, str(Path(__file__).absolute().parents[1])]))


def _real(path: Path) -> str:
    try:
        return os.path.normcase(path.resolve())
    except (OSError, RuntimeError):  # the current folder is gone, or links go round in circles
        return str(path)
