"""Modelica to FMU: needs the extra dependencies `fmuid[export]`, not needed to identify.

`README.md` in this folder documents the subset of Modelica.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from fmuid.errors import InputError

VERSIONS = ("2.0", "3.0")  # supported FMI versions


def export_fmu(
    source: Path, output: Path | None = None, *, fmi: str = "2.0", sensitivities: Sequence[str] | Literal["all"] = ()
) -> Path:
    """Export a Modelica model as an FMU for model exchange and co-simulation.

    Parameters
    ----------
    source
        A file with one flat model in the supported subset.
    output
        The FMU to write; by default ``<Model>.fmu`` beside the source.
    fmi
        The version of FMI: one of `VERSIONS`.
    sensitivities
        Parameters p, or "all" for every one: the FMU also computes the forward sensitivities ∂y/∂p of each output y,
        as an output ``sens.p.y`` of the unit of y/p, and those of the states.

    Returns
    -------
    Path
        The FMU, with binaries for Linux, Windows and macOS: the same bytes wherever it is exported.

    Raises
    ------
    InputError
        If the extra dependencies are missing, the source cannot be read or the FMU not written; for an unknown version
        of FMI or an unknown parameter.
    ModelicaError
        For a syntax error or a construct outside the subset, or one that has no sensitivities, with its line.

    Warns
    -----
    ModelicaWarning
        For a parameter that is used nowhere, and where the experiment annotation gives no Interval.
    """
    if fmi not in VERSIONS:
        raise InputError(f"there is no export to FMI '{fmi}': give one of {', '.join(VERSIONS)}")
    try:
        from fmuid.export.build import build
        from fmuid.export.equations import analyse
        from fmuid.export.explicit_model import remarks
        from fmuid.export.parse import parse
        from fmuid.export.sensitivities import with_sensitivities
    except ImportError as error:
        raise InputError(f"exporting needs '{error.name}': pip install 'fmuid[export]'") from None
    source = Path(source)
    plain = analyse(parse(source))
    system = with_sensitivities(plain, sensitivities)
    target = source.with_name(f"{system.model.name}.fmu") if output is None else Path(output)
    data = build(system, fmi)
    try:
        target.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}; name another output") from None
    for remark in remarks(plain):
        warnings.warn(remark, stacklevel=2)
    return target
