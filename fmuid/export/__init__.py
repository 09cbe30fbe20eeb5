"""Modelica to FMU: needs the extra dependencies `fmuid[export]`, not needed to identify.

`README.md` in this folder documents the subset of Modelica.
"""

from __future__ import annotations

from pathlib import Path

from fmuid.errors import InputError


def export_fmu(source: Path, output: Path | None = None) -> Path:
    """Export a Modelica model as an FMU 2.0 for model exchange and co-simulation.

    Parameters
    ----------
    source
        A file with one flat model in the supported subset.
    output
        The FMU to write; by default ``<Model>.fmu`` beside the source.

    Returns
    -------
    Path
        The FMU, with binaries for Linux, Windows and macOS: the same bytes wherever it is exported.

    Raises
    ------
    InputError
        If the extra dependencies are missing, the source cannot be read or the FMU not written.
    ModelicaError
        For a syntax error or a construct outside the subset, with its line.
    """
    try:
        from fmuid.export.build import build
        from fmuid.export.equations import analyse
        from fmuid.export.parse import parse
    except ImportError as error:
        raise InputError(f"exporting needs '{error.name}': pip install 'fmuid[export]'") from None
    source = Path(source)
    system = analyse(parse(source))
    target = source.with_name(f"{system.model.name}.fmu") if output is None else Path(output)
    data = build(system)
    try:
        target.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}; name another output") from None
    return target
