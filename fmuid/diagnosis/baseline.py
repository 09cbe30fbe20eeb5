"""The baseline of a diagnosis: the healthy machine from a result, records or a file."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from fmuid.array_types import Floats
from fmuid.codec import as_json, from_json
from fmuid.data import Experiment, Noise, Parameter, read_arrays, write_arrays
from fmuid.diagnosis.causes import ChangeParameterSet, name_of
from fmuid.diagnosis.faults import VARIANT, common_mode
from fmuid.diagnosis.information_matrix import InformationMatrix, Whitening
from fmuid.diagnosis.operating_points import OperatingPoints
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import HealthyStructure
from fmuid.errors import InputError
from fmuid.estimation import OutputNoise, Result
from fmuid.identification import refinement_of
from fmuid.models import System
from fmuid.simulation import Refinement

REMEDY = "Identify the healthy study again."


class BaselineSource(Enum):
    """Source of the healthy machine; "other …" are records whose file is of something else."""

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
    WHITE_RESULT = "result without noise"
    """A result from a file without noise model: noise counts as white."""

    @property
    def alone(self) -> bool:
        """True if there are no healthy data."""
        return self in (BaselineSource.RESULT, BaselineSource.WHITE_RESULT)


@dataclass(frozen=True, eq=False)
class MachineDigest:
    """Identity of a stored baseline: models, coordinates, noise and records."""

    models: Mapping[str, str]  # digests of the healthy machine, "", and of each fault
    coordinates: tuple[str, ...]
    healthy: Floats  # (N,)
    noise: Any  # the given variances as JSON; None where they are estimated
    records: tuple[str, ...]  # digest of each healthy record

    @classmethod
    def of(cls, system: System, baseline: Baseline, coordinates: ChangeParameterSet) -> MachineDigest:
        """Return the digest of a healthy machine and its faults."""
        # columns of structure depend on its settings
        how = baseline.values, baseline.refinement
        models = {"": _digest(_model(system), how, UNEXPLAINED_RESIDUAL)}
        for name, fault in coordinates.faults.items():
            said = (list(fault.parameters), fault.variable_map, fault.angles, fault.values, fault.inputs)
            models[name] = _digest(_model(System.of(fault.model)), said)
        names = tuple(
            f"{name_of(each.kind, each.variable, each.fault)}{' across' * each.second}" for each in coordinates.each
        )
        noise, records = as_json(baseline.noise_variance), tuple(map(digest_of_record, baseline.records))
        return cls(models, names, coordinates.healthy, noise, records)

    def unlike(self, asked: MachineDigest, *, fewer: bool) -> BaselineSource | None:
        """Return the difference from a digest asked for, None if it serves; `fewer` allows fewer causes."""
        if any(self.models.get(name) != digest for name, digest in asked.models.items()):
            return BaselineSource.OTHER_MODELS
        mine, theirs = set(self.coordinates), set(asked.coordinates)
        alike = theirs in (mine, {name for name in mine if VARIANT not in name})  # monitoring takes no variants
        if not theirs <= mine or not (fewer or alike):
            return BaselineSource.OTHER_CAUSES
        # equal but for the last digits of a text file
        if not np.allclose(self.healthy[self._places(asked)], asked.healthy, rtol=1e-9, atol=0.0):
            return BaselineSource.OTHER_MODELS
        if self.noise != asked.noise:
            return BaselineSource.OTHER_NOISE
        if not set(asked.records) <= set(self.records):
            return BaselineSource.OTHER_RECORDS
        return None

    def _places(self, asked: MachineDigest) -> list[int]:
        return [self.coordinates.index(name) for name in asked.coordinates]

    def among(self, shown: StoredBaseline, asked: MachineDigest) -> StoredBaseline:
        """Return the sums of the coordinates asked for, in their order."""
        at = self._places(asked)
        if at == list(range(len(self.coordinates))):
            return shown
        outputs = [[one.among(at) for one in each] for each in shown.outputs]
        return replace(shown, outputs=outputs, structure=shown.structure.among(at))


@dataclass(frozen=True, eq=False)
class StoredBaseline:
    """Sums of healthy records, kept in ``baseline.npz``."""

    outputs: Sequence[Sequence[InformationMatrix]]  # by record and output, relative to the healthy coordinates
    samples: Floats  # (K, n_outputs)
    structure: HealthyStructure
    points: OperatingPoints
    whitening: Whitening
    lines: tuple[float, float]  # rms voltage and current of lines
    subject: MachineDigest | None = None
    path: Path | None = None  # the file that it was read from

    @cached_property
    def said(self) -> tuple[InformationMatrix, ...]:
        """Information of each record."""
        return tuple(sum(each[1:], start=each[0]) for each in self.outputs)

    def extended(self, new: StoredBaseline, digests: Sequence[str]) -> StoredBaseline:
        """Return the baseline with more records, of the same coordinates and noise."""
        assert self.subject is not None
        structure = HealthyStructure(
            self.structure.groups,
            (*self.structure.records, *new.structure.records),
            self.structure.samples + new.structure.samples,
        )
        points = OperatingPoints(self.points.names, np.vstack([self.points.values, new.points.values]))
        subject = replace(self.subject, records=(*self.subject.records, *digests))
        outputs, samples = [*self.outputs, *new.outputs], np.vstack([self.samples, new.samples])
        return StoredBaseline(outputs, samples, structure, points, self.whitening, self.lines, subject)

    def write(self, path: Path) -> Path:
        """Write ``baseline.npz`` and return its path."""
        assert self.subject is not None
        how = self.structure
        what = self.subject, self.whitening.models, how.groups, how.samples, self.points.names, self.lines
        text = as_json(_Description(*what))
        arrays = {
            "text": np.frombuffer(json.dumps(text).encode(), np.uint8),
            "matrices": np.array([[one.matrix for one in each] for each in self.outputs]),
            "scores": np.array([[one.score for one in each] for each in self.outputs]),
            "squares": np.array([[one.squares for one in each] for each in self.outputs]),
            "samples": self.samples,
            "structure": np.array([each.matrix for each in self.structure.records]),
            "structure_scores": np.array([each.score for each in self.structure.records]),
            "points": self.points.values,
        }
        return write_arrays(path, arrays)

    @classmethod
    def read(cls, path: Path, *, needed: bool = True) -> StoredBaseline:
        """Read a ``baseline.npz``; of a damaged one that is not `needed` only the path."""
        try:
            sums = read_arrays(path)
            text = from_json(_Description, json.loads(sums.pop("text").tobytes()))
            each = zip(sums["matrices"], sums["scores"], sums["squares"].tolist(), strict=True)
            outputs = [list(map(InformationMatrix, *one)) for one in each]
            parts = tuple(map(InformationMatrix, sums["structure"], sums["structure_scores"]))
            structure = HealthyStructure(text.groups, parts, text.samples)
            points = OperatingPoints(text.points, sums["points"])
            noise = Whitening(text.noise)
            return cls(outputs, sums["samples"], structure, points, noise, text.lines, text.of, path)
        except (KeyError, ValueError, TypeError) as error:
            if needed:
                raise InputError(f"{path}: no complete file of fmuid identify ({error}). {REMEDY}") from None
            nothing = np.zeros((0, 0))
            none = nothing, HealthyStructure({}, (), 0), OperatingPoints((), nothing)
            return cls((), *none, Whitening({}), (0.0, 0.0), None, path)


@dataclass(frozen=True, eq=False)
class _Description:
    """Text of a ``baseline.npz``."""

    of: MachineDigest
    noise: Mapping[str, OutputNoise]
    groups: Mapping[str, tuple[int, ...]]
    samples: int
    points: tuple[str, ...]
    lines: tuple[float, float]


def _model(system: System) -> Any:
    """Return everything that a model's outputs depend on, except values and inputs."""
    components = {name: (each.fmu.digest, each.numerics) for name, each in system.components.items()}
    return components, system.connections, system.connectors, system.values, system.master


def _digest(*content: Any) -> str:
    return hashlib.sha256(json.dumps(as_json(content), sort_keys=True).encode()).hexdigest()


def digest_of_record(record: Experiment) -> str:
    """Return the digest of a record's numbers."""
    names = [record.input_names, record.output_names, record.interpolation]
    found = hashlib.sha256(_digest(names).encode())
    for each in (record.times, record.input_values, record.output_values, record.counted):
        found.update(np.ascontiguousarray(each).tobytes())
    return found.hexdigest()


@dataclass(frozen=True, eq=False)
class Baseline:
    """The healthy machine of a diagnosis.

    Parameters
    ----------
    result : Result
        Of the healthy machine.
    std_factor : float or mapping of str to float
        Factor on the standard deviations of its estimates for sound changes (1.67); infinite for any value.
    noise_variance : float or mapping of output to float, optional
        Default: the result's.
    parameters : mapping of str to Parameter
        Nominal parameters with bounds, or without an estimate in the result.
    values : mapping
        Fixed variables of the nominal model.
    records : sequence of Experiment
        Healthy data with the same inputs and outputs. They separate sensor and supply errors from faults; four or more
        at different operating points also show the healthy model's error.
    trials : mapping of str to sequence of Experiment
        Data of known causes: they show the fault models' error.
    shown : StoredBaseline, optional
        Sums of the healthy data from the identification, used where models, faults and data are the same.

    Attributes
    ----------
    common : dict of str to Parameter
        Nominal parameters with the healthy estimates as priors.

    Raises
    ------
    InputError
        If the result has no estimate, a factor is not positive, a parameter has a second prior, or trials come without
        healthy data.

    Examples
    --------
    >>> result = fmuid.identify(fmuid.datasets.coil().problem())
    >>> healthy = fmuid.Baseline(result, std_factor={"R": 10.0})
    >>> round(healthy.common["R"].prior.std / result["R"].std, 1)
    10.2
    """

    result: Result
    std_factor: float | Mapping[str, float] = 1.0
    noise_variance: float | Mapping[str, float] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    records: Sequence[Experiment] = ()
    trials: Mapping[str, Sequence[Experiment]] = field(default_factory=dict)
    shown: StoredBaseline | None = None
    common: dict[str, Parameter] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.trials and not self.beside:
            raise InputError("known fault data need healthy data for comparison. Give records, too.")
        object.__setattr__(self, "common", common_mode(self.result, self.std_factor, self.parameters, self.values))

    @classmethod
    def of(cls, given: Self | Result | str | Path) -> Self:
        """Return a baseline, also of a result or of its ``result.json``; errors as of both."""
        if isinstance(given, cls):
            return given
        return cls(given if isinstance(given, Result) else Result.from_json(given))  # type: ignore[arg-type]

    @property
    def beside(self) -> bool:
        """True if healthy data describe sensors and supply, too."""
        return bool(self.records) or self.shown is not None

    @property
    def refinement(self) -> Refinement:
        """Solver refinement of the healthy machine and its comparisons."""
        return refinement_of(self.result)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the noise variances; infinite if given."""
        return float(self.result.fit.degrees_of_freedom) if self.noise_variance is None else math.inf

    def noise(self, output: str, variance: float) -> OutputNoise:
        """Return the noise of an output, white where the result has none."""
        known = self.result.fit.output_noise.get(output)
        if known is None:
            return OutputNoise.white(variance)
        return known if self.noise_variance is None else known.of_variance(variance)

    def variance(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the noise variance of each output; an `InputError` if one is not known."""
        if self.noise_variance is not None:
            given = dict(zip(outputs, Noise(self.noise_variance).known(tuple(outputs)).tolist(), strict=True))
            for name, value in given.items():
                if math.isnan(value):
                    raise InputError(f"noise.variance lacks the output {name!r}. Add it.")
            return given
        known = self.result.fit.variance
        for name in (each for each in outputs if each not in known):
            said = f"the healthy result has no noise variance of {name!r}, only of {', '.join(known)}"
            raise InputError(f"{said}. Measure the same outputs, or give noise.variance.")
        return {name: known[name] for name in outputs}
