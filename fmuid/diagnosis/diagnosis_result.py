"""Diagnosis: verdict, changes, probabilities, JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from fmuid import codec
from fmuid.diagnosis.cause_results import ChangeEvidence, EstimatedChange
from fmuid.diagnosis.operating_points import Coverage
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import VarianceRatio
from fmuid.display_mixins import PlotMixin
from fmuid.errors import InputError
from fmuid.estimation import Result, SolverCheck

DIAGNOSIS_SCHEMA = "fmuid/diagnosis/2"
# A cause whose model explains less than this share of what exceeds the noise is not what is wrong.
EXPLAINED_SHARE = 0.5

Estimate = tuple[float, float]
"""Value and standard deviation."""


@dataclass(frozen=True)
class BaselineDeviation:
    """A nominal parameter outside its prior.

    Attributes
    ----------
    distance : float
        In standard deviations of baseline and record together.
    """

    name: str
    distance: float


@dataclass(frozen=True, eq=False)
class Diagnosis(PlotMixin):
    """Result of a diagnosis.

    Attributes
    ----------
    level : float
        False-alarm probability.
    unexplained : VarianceRatio
        Residual variance with the named causes; beside healthy data its change of correlation with the inputs.
    nominal : dict of str to (value, std)
        Healthy parameters beside the named causes.
    deviation : BaselineDeviation or None
        Without healthy data; with them a parameter is a cause.
    version : str
        Of fmuid.
    accuracy : SolverCheck or None
        Of the fit of the named fault; None without one.
    fitted : tuple of str
        Parameters of that fit, in the order of `SolverCheck.shift`.
    result : Result or None
        That fit; not kept in a file.
    mismatched : tuple of str
        Faults whose models without their fault are not the healthy machine.
    coverage : Coverage or None
        Operating points of the healthy records; None of a result alone.
    detectable : dict of str to float
        Size of each fault that shows in 95 % of such records, by ``turns.dR``.
    residuals : DataFrame or None
        Of the first experiment, ``healthy.`` and ``fault.`` before each output; not kept in a file.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> found = fmuid.diagnose(test.experiment, fmuid.identify(coil.problem()), {"turns": turns}, coil.fmu)
    >>> round(found["turns.dR"].value, 2)
    -0.08
    """

    level: float
    evidence: ChangeEvidence
    unexplained: VarianceRatio
    nominal: Mapping[str, Estimate]
    noise_variance: Mapping[str, float]
    deviation: BaselineDeviation | None
    version: str
    accuracy: SolverCheck | None = None
    fitted: tuple[str, ...] = ()
    result: Result | None = None
    mismatched: tuple[str, ...] = ()
    residuals: pd.DataFrame | None = None
    coverage: Coverage | None = None
    detectable: Mapping[str, float] = field(default_factory=dict)

    json_layout: ClassVar = codec.Layout(omitted={"result", "residuals"}, derived=("kind", "named"))

    def __repr__(self) -> str:
        return f"Diagnosis({self.kind}{': ' if self.named else ''}{', '.join(self.named)})"

    def __getitem__(self, name: str) -> EstimatedChange:
        """Return a named change, or a cause alone: ``turns.dR``, ``gain(i)``, ``R``."""
        found = {each.change.label: each.change for each in self.evidence.suspects}
        found |= {each.label: each for one in reversed(self.evidence.explanations) for each in one.changes}
        if name not in found:
            raise InputError(f"unknown cause {name!r}. Choose {', '.join(found)}.")
        return found[name]

    @property
    def named(self) -> tuple[str, ...]:
        """Named faults: the most likely one, and those indistinguishable from it."""
        return self.evidence.faults

    @property
    def kind(self) -> str:
        """Verdict.

        ``"fault"``, ``"other"`` (a sensor, the supply or a parameter), ``"ambiguous"``, ``"unexplained"``,
        ``"undecided"`` (a fault is not identifiable) or ``"healthy"``.
        """
        known = self.evidence.basis.alone and self.evidence.explained >= EXPLAINED_SHARE
        if self.is_partial and not known:
            return "unexplained"
        if self.evidence.alarm:
            if len(self.evidence.explanations) > 1:
                return "ambiguous"
            return "fault" if self.named else "other"
        return "undecided" if self.undetermined else "healthy"

    @property
    def is_partial(self) -> bool:
        """True if the named causes leave more than healthy noise."""
        if self.evidence.basis.alone:
            return self.unexplained.is_larger(UNEXPLAINED_RESIDUAL.level_share * self.level)
        return self.unexplained.probability < UNEXPLAINED_RESIDUAL.structure_share * self.level

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Sizes of faults that the record does not determine."""
        each = (one.change for one in self.evidence.suspects)
        return tuple(one.label for one in each if one.fault and not one.is_determined)

    @property
    def table(self) -> pd.DataFrame:
        """One row a cause, with the sizes of the best explanation."""
        odds = {each.label: one.odds for one in reversed(self.evidence.explanations) for each in one.changes}
        rows = []
        for one in self.evidence.suspects:
            each = self[one.change.label]
            row: dict[str, Any] = {"cause": each.label, "kind": each.kind.value, "value": each.value, "std": each.std}
            row |= dict(zip(("lower", "upper"), each.interval(), strict=True)) | {"unit": each.unit}
            row |= {"angle": each.angle, "angle_value": each.angle_value, "angle_std": each.angle_std}
            row |= {"D": one.statistic, "probability": one.probability, "odds": odds.get(each.label, 0.0)}
            rows.append(row | {"rival": one.rival, "rival_angle": one.rival_angle})
        return pd.DataFrame(rows)

    # --- JSON

    def to_json(self, path: str | Path) -> Path:
        """Write ``diagnosis.json`` and return its path.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        return codec.write(Path(path), DIAGNOSIS_SCHEMA, self)

    @classmethod
    def from_json(cls, path: str | Path) -> Diagnosis:
        """Read a ``diagnosis.json``, without fit and residuals.

        Raises
        ------
        InputError
            If the file cannot be read or is no such file.
        """
        return codec.read(Path(path), DIAGNOSIS_SCHEMA, cls, "run fmuid diagnose again")
