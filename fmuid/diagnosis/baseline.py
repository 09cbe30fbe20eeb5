"""The baseline of a diagnosis: the healthy machine from a result, records or a file, and what may change in it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, Self

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment, Noise, Parameter, read_arrays, write_arrays
from fmuid.diagnosis.causes import ChangeParameterSet
from fmuid.diagnosis.faults import Fault, common_mode
from fmuid.diagnosis.information_matrix import InformationMatrix
from fmuid.diagnosis.prewhitening import Whitening
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.errors import InputError
from fmuid.estimation import Autoregression, Result
from fmuid.files import as_json, read_content
from fmuid.identification import refinement_of
from fmuid.models import System
from fmuid.simulation import Refinement
from fmuid.version import __version__

KIND, REMEDY = "the baseline.npz of fmuid identify", "identify the healthy study again"
# Healthy values of the file and of the result beside it are the same numbers, but for their last digits.
SAME_VALUE = 1e-9


class BaselineSource(Enum):
    """Where a diagnosis has the healthy machine from."""

    RECORDS = "records"
    FILE = "file"
    """What the identification of the healthy machine wrote."""
    OTHER_MODELS = "other models"
    """The records, as the file is of other models or values."""
    OTHER_CAUSES = "other causes"
    OTHER_NOISE = "other noise"
    OTHER_RECORDS = "other records"
    DAMAGED = "damaged"
    RESULT = "result"
    """Its result alone: nothing is known of sensors and supply."""


@dataclass(frozen=True, eq=False)
class MachineDigest:
    """What a file of healthy records is of.

    Attributes
    ----------
    models : dict of str to str
        Digest of the healthy machine, as "", and of each fault.
    coordinates : tuple of str
    healthy : (N,) array
    noise : object
        The variances given, as JSON has them; None where they are estimated.
    records : tuple of str
        Digest of each healthy record.
    """

    models: Mapping[str, str]
    coordinates: tuple[str, ...]
    healthy: Floats
    noise: Any
    records: tuple[str, ...]

    @classmethod
    def of(
        cls,
        machine: tuple[System, Mapping[str, Any], Any],
        faults: Mapping[str, Fault],
        coordinates: ChangeParameterSet,
        noise: Any,
        records: Sequence[Experiment],
    ) -> MachineDigest:
        """Return that of a machine: its model, the values that it is held at, and how finely it is simulated."""
        # `owed` has a coefficient for each span
        models = {"": _digest(_model(machine[0]), machine[1:], UNEXPLAINED_RESIDUAL.spans)}
        for name, fault in faults.items():
            said = (list(fault.parameters), fault.names, fault.angles, fault.values, fault.inputs)
            models[name] = _digest(_model(System.of(fault.model)), said)
        names = tuple(f"{each.name}{' across' * each.second}" for each in coordinates.each)
        return cls(models, names, coordinates.healthy, as_json(noise), tuple(map(_of_record, records)))

    def unlike(self, asked: MachineDigest, *, fewer: bool) -> BaselineSource | None:
        """Return why it does not serve where something is asked, of `fewer` causes or of the same; None if it does."""
        if any(self.models.get(name) != digest for name, digest in asked.models.items()):
            return BaselineSource.OTHER_MODELS
        mine, theirs = set(self.coordinates), set(asked.coordinates)
        if not theirs <= mine or not (fewer or mine == theirs):
            return BaselineSource.OTHER_CAUSES
        if not np.allclose(self.healthy[self._places(asked)], asked.healthy, rtol=SAME_VALUE, atol=0.0):
            return BaselineSource.OTHER_MODELS
        if self.noise != asked.noise:
            return BaselineSource.OTHER_NOISE
        if asked.records and sorted(asked.records) != sorted(self.records):
            return BaselineSource.OTHER_RECORDS
        return None

    def _places(self, asked: MachineDigest) -> list[int]:
        return [self.coordinates.index(name) for name in asked.coordinates]

    def among(self, shown: StoredBaseline, asked: MachineDigest) -> StoredBaseline:
        """Return what was shown of the coordinates asked for, in their order, without a change of the others."""
        at = self._places(asked)
        said = tuple(InformationMatrix(each.matrix[np.ix_(at, at)], each.score[at]) for each in shown.said)
        return replace(shown, said=said)


@dataclass(frozen=True, eq=False)
class StoredBaseline:
    """What healthy records showed.

    Attributes
    ----------
    said : tuple of InformationMatrix
        Of each record, on all coordinates and relative to the healthy ones.
    owed : InformationMatrix
        What the residuals owe to the inputs.
    whitening : Whitening
        By which all of it is white.
    subject : MachineDigest or None
        What a file of it is of.
    path : Path or None
        That file.
    """

    said: tuple[InformationMatrix, ...]
    owed: InformationMatrix
    whitening: Whitening
    subject: MachineDigest | None = None
    path: Path | None = None

    def write(self, path: Path) -> Path:
        """Write ``baseline.npz`` and return its path."""
        assert self.subject is not None
        text = {"version": __version__, "of": self.subject, "noise": self.whitening.models}
        arrays = {
            "text": np.frombuffer(json.dumps(as_json(text)).encode(), np.uint8),
            "matrices": np.array([each.matrix for each in self.said]),
            "scores": np.array([each.score for each in self.said]),
            "owed": self.owed.matrix,
            "owed_score": self.owed.score,
        }
        return write_arrays(path, arrays)

    @classmethod
    def read(cls, path: Path, *, needed: bool = True) -> StoredBaseline:
        """Read a ``baseline.npz``.

        Parameters
        ----------
        path : Path
        needed : bool
            Whether there are no records to examine again; else only the path of a damaged file is returned.

        Raises
        ------
        InputError
            If it is needed and cannot be read, or is something else.
        """
        try:
            return cls._read(path)
        except InputError:
            if needed:
                raise
            return cls((), InformationMatrix(np.zeros((0, 0)), np.zeros(0)), Whitening({}), None, path)

    @classmethod
    def _read(cls, path: Path) -> StoredBaseline:
        try:
            sums = read_arrays(path)
            text = sums.pop("text").tobytes()
            said = tuple(map(InformationMatrix, sums["matrices"], sums["scores"]))
            owed = InformationMatrix(sums["owed"], sums["owed_score"])
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"{path} is not of fmuid identify, or not whole ({error}): {REMEDY}") from None
        with read_content(text, path, KIND, REMEDY) as content:
            own, noise = content["of"], content["noise"]
            names, records = tuple(own["coordinates"]), tuple(own["records"])
            subject = MachineDigest(own["models"], names, np.array(own["healthy"], dtype=float), own["noise"], records)
            models = {
                name: Autoregression(**each | {"coefficients": np.array(each["coefficients"], dtype=float)})
                for name, each in noise.items()
            }
        return cls(said, owed, Whitening(models), subject, path)


def _model(system: System) -> Any:
    """Return all that a model's outputs depend on beside values and inputs."""
    components = {name: (each.fmu.digest, each.numerics) for name, each in system.components.items()}
    return components, system.connections, system.connectors, system.values, system.master


def _digest(*content: Any) -> str:
    return hashlib.sha256(json.dumps(as_json(content), sort_keys=True, default=str).encode()).hexdigest()


def _of_record(record: Experiment) -> str:
    """Return the digest of the numbers that a record is compared by."""
    names = [record.input_names, record.output_names, record.interpolation]
    found = hashlib.sha256(_digest(names).encode())
    for each in (record.times, record.input_values, record.output_values, record.counted):
        found.update(np.ascontiguousarray(each).tobytes())
    return found.hexdigest()


@dataclass(frozen=True, eq=False)
class Baseline:
    """The healthy machine, as records are compared with it.

    Parameters
    ----------
    result : Result
        Of the healthy machine.
    inflate : float or mapping of str to float
        Factor on the standard deviations of its estimates for variations that are no fault (1.67); infinite for
        parameters that may be anything.
    noise_variance : float or mapping of output to float, optional
        Default: that of the result.
    parameters : mapping of str to Parameter
        Nominal parameters with bounds, or of which the result knows nothing.
    values : mapping
        Variables of the nominal model held at a value; fault models have their own.
    records : sequence of Experiment
        The healthy records, with the inputs and outputs of those to be diagnosed. With them errors of sensors and
        supply are told from faults, and those that the machine always had are no news; four or more at different
        operating points show the healthy model's own error, too.
    trials : mapping of str to sequence of Experiment
        Cause to records in which it alone is new: they show the fault models' error.
    shown : StoredBaseline, optional
        What the healthy records showed when the healthy machine was identified: taken where it is of the same machine,
        faults and records, or none are given.

    Attributes
    ----------
    common : dict of str to Parameter
        The nominal parameters with what the healthy machine showed as their prior.

    Raises
    ------
    InputError
        If the result has nothing to say, a factor is not positive, a parameter has a second prior, or trials
        have no records beside them.

    Examples
    --------
    >>> result = fmuid.identify(fmuid.datasets.coil().problem())
    >>> healthy = fmuid.Baseline(result, inflate={"R": 10.0})
    >>> round(healthy.common["R"].prior.std / result["R"].std, 1)
    10.2
    """

    result: Result
    inflate: float | Mapping[str, float] = 1.0
    noise_variance: float | Mapping[str, float] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    records: Sequence[Experiment] = ()
    trials: Mapping[str, Sequence[Experiment]] = field(default_factory=dict)
    shown: StoredBaseline | None = None
    common: dict[str, Parameter] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.trials and not self.beside:
            raise InputError("trials are compared with healthy records: name the tables of the healthy machine, too")
        object.__setattr__(self, "common", common_mode(self.result, self.inflate, self.parameters, self.values))

    @classmethod
    def of(cls, given: Self | Result | str | Path) -> Self:
        """Return a baseline: the one given, or that of a result or of its ``result.json`` with nothing else known.

        Raises
        ------
        InputError
            If the file cannot be read, or as the class.
        """
        if isinstance(given, cls):
            return given
        return cls(given if isinstance(given, Result) else Result.from_json(given))  # type: ignore[arg-type]

    @property
    def beside(self) -> bool:
        """Whether healthy records say what the sensors and the supply are like, too."""
        return bool(self.records) or self.shown is not None

    @property
    def refinement(self) -> Refinement:
        """How much finer than asked for the healthy machine was simulated: what is compared with it must be, too."""
        return refinement_of(self.result)

    @property
    def freedom(self) -> float:
        """Degrees of freedom behind the noise variances; infinite where they are given."""
        return float(self.result.degrees_of_freedom) if self.noise_variance is None else math.inf

    def variance(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the noise variance of each output.

        Raises
        ------
        InputError
            If that of one of them is not known.
        """
        if self.noise_variance is not None:
            given = dict(zip(outputs, Noise(self.noise_variance).known(tuple(outputs)).tolist(), strict=True))
            for name, value in given.items():
                if math.isnan(value):
                    raise InputError(f"noise.variance has none of {name!r}, and a diagnosis needs it: give it too")
            return given
        known = self.result.variance
        for name in outputs:
            if name not in known:
                raise InputError(
                    f"the healthy result has no noise variance of {name!r}, only of {', '.join(known)}: "
                    "measure the same outputs, or give noise.variance"
                )
        return {name: known[name] for name in outputs}

    @property
    def variances(self) -> Mapping[str, float]:
        """The noise variances that are known, by output."""
        if isinstance(self.noise_variance, Mapping):
            return self.noise_variance
        known = self.result.variance
        return known if self.noise_variance is None else dict.fromkeys(known, self.noise_variance)
