"""Example data: three small recordings with their FMUs and true values.

They are simulated from the equations in the models' README files, without the FMUs (``tools/make_datasets.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid.data import Experiment, Parameter, read_data
from fmuid.errors import InputError
from fmuid.formatting import nearest

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.identification import Problem

__all__ = ["coil", "faulty_coil", "induction_machine", "load"]

HERE = Path(__file__).parent


@dataclass(frozen=True)
class ExampleRecord:
    """A recording with its FMU.

    Attributes
    ----------
    path, fmu : Path
        The CSV file and the FMU.
    inputs, outputs : tuple of str
        Columns of the file and variables of the FMU; there is a column ``time``, s, too.
    parameters : mapping of str to Parameter
        With wrong initial guesses.
    truth : mapping of str to float
        True values.
    """

    name: str
    path: Path
    fmu: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: Mapping[str, Parameter]
    truth: Mapping[str, float]

    @property
    def table(self) -> pd.DataFrame:
        """The data file."""
        return read_data(self.path)

    @property
    def experiment(self) -> Experiment:
        """The data with the roles of their columns."""
        return Experiment(self.table, inputs=self.inputs, outputs=self.outputs, name=self.name)

    def problem(self) -> Problem:
        """Return the problem of identifying the parameters."""
        from fmuid.identification import Problem

        return Problem(self.fmu, self.experiment, self.parameters)

    @property
    def study(self) -> dict[str, Any]:
        """Content of its study file, for ``fmuid.Study.of``."""
        table = {"data": str(self.path), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        parameters = {name: {"start": each.start, "min": each.min} for name, each in self.parameters.items()}
        return {"title": self.name, "model": {"fmu": str(self.fmu)}, "experiments": [table], "parameters": parameters}


def load(name: str) -> ExampleRecord:
    """Return a data set by its name.

    Parameters
    ----------
    name : "coil", "faulty_coil" or "induction_machine"

    Raises
    ------
    InputError
        If the name is unknown.

    Examples
    --------
    >>> import fmuid
    >>> coil = fmuid.datasets.load("coil")
    >>> list(coil.table), coil.fmu.name
    (['time', 'u', 'i'], 'Coil.fmu')
    """
    made = {each.__name__: each for each in (coil, faulty_coil, induction_machine)}
    if name not in made:
        raise InputError(f"there is no data set {name!r}{nearest(name, made)}; there are {', '.join(made)}")
    return made[name]()


def coil() -> ExampleRecord:
    """Return 200 samples of a coil under a pseudo-random voltage.

    Examples
    --------
    >>> import fmuid
    >>> coil = fmuid.datasets.coil()
    >>> result = fmuid.identify(coil.problem())
    >>> result["R"], coil.truth["R"]
    (R = 3.9985 ± 0.0016 Ohm, 4.0)
    """
    parameters = {"R": Parameter(3.0, min=0.0), "L": Parameter(0.2, min=1e-3)}
    return _record("coil", "Coil", "u", "i", parameters, {"R": 4.0, "L": 0.1})


def faulty_coil() -> ExampleRecord:
    """Return the same coil with 2 % of its turns lost: ``dR`` is −0.08 ohm.

    Examples
    --------
    >>> import fmuid
    >>> fmuid.datasets.faulty_coil().truth
    {'dR': -0.08}
    """
    parameters = {"dR": Parameter(0.0, nominal=1.0, min=-1.0)}
    return _record("faulty_coil", "FaultyCoil", "u", "i", parameters, {"dR": -0.08})


def induction_machine() -> ExampleRecord:
    """Return 400 samples of an induction machine in rotor axes.

    Examples
    --------
    >>> import fmuid
    >>> result = fmuid.identify(fmuid.datasets.induction_machine().problem())
    >>> [round(value, 2) for value in result.values.tolist()]
    [9.8, 3.8, 0.44, 0.08]
    """
    starts = {"Rs": 14.7, "Rr": 1.9, "Lm": 0.654, "Lf": 0.0381}
    parameters = {name: Parameter(start, min=1e-3) for name, start in starts.items()}
    truth = {"Rs": 9.8, "Rr": 3.8, "Lm": 0.436, "Lf": 0.0762}
    return _record("induction_machine", "InductionMachine", "uds uqs w", "ids iqs", parameters, truth)


def _record(
    name: str, model: str, inputs: str, outputs: str, parameters: Mapping[str, Parameter], truth: Mapping[str, float]
) -> ExampleRecord:
    packed = HERE / f"{model}.fmu"  # of a wheel; in a clone it lies with the other models
    fmu = packed if packed.is_file() else HERE.parents[1] / "fmus" / model / packed.name
    columns = tuple(inputs.split()), tuple(outputs.split())
    return ExampleRecord(name, HERE / f"{name}.csv", fmu, *columns, parameters, truth)
