"""What a diagnosis found, in numbers and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.diagnosis.cause_results import ChangeEvidence
from fmuid.diagnosis.fault_fits import FitSolverCheck
from fmuid.diagnosis.hypothesis import BaselineDeviation, Estimate, FaultHypothesis, estimates_of
from fmuid.display_mixins import PlotMixin
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import as_json, content_of, write_json

# A fault whose model explains less than this share of what exceeds the noise is not what is wrong.
EXPLAINED_SHARE = 0.5


@dataclass(frozen=True)
class ResidualVarianceTest:
    """The residual of the most likely model against the noise of the healthy machine.

    Attributes
    ----------
    ratio : float
        Of the variances.
    probability : float
        That noise alone gives as much.
    larger : bool
        Whether that is too unlikely.
    explained : float
        How much of what exceeds the noise without a fault the fault explains; 0 where none was named.
    """

    ratio: float
    probability: float
    larger: bool
    explained: float = 0.0


@dataclass(frozen=True, eq=False)
class Diagnosis(PlotMixin):
    """What a diagnosis found.

    Attributes
    ----------
    level : float
        Probability of an alarm where nothing is wrong.
    hypotheses : tuple of FaultHypothesis
    called : tuple of str
        The hypotheses that are significant.
    named : tuple of str
        Of these the most likely one, and those that the data do not tell apart from it.
    unexplained : ResidualVarianceTest
        Whether the residual is larger than the noise even so.
    samples : int
    noise_variance : dict of str to float
    nominal : dict of str to (value, std)
        The healthy model fitted.
    ended : bool
        Whether that fit ended at a minimum.
    strain : BaselineDeviation or None
        The nominal parameter that has left what was foreseen.
    version : str
        Of fmuid.
    result : Result or None
        The fit of the healthy model; not kept in a file.
    checked : FitSolverCheck
        What the error of the simulation does to it.
    evidence : ChangeEvidence or None
        What is new beside the healthy records, faults and all other causes; None where there are none. It decides
        what is named.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> found = fmuid.diagnose(test.experiment, fmuid.identify(coil.problem()), {"turns": turns}, coil.fmu)
    >>> round(found["turns"]["dR"].value, 2)
    -0.08
    """

    level: float
    hypotheses: tuple[FaultHypothesis, ...]
    called: tuple[str, ...]
    named: tuple[str, ...]
    unexplained: ResidualVarianceTest
    samples: int
    noise_variance: Mapping[str, float]
    nominal: Mapping[str, Estimate]
    ended: bool
    strain: BaselineDeviation | None
    version: str
    result: Result | None = None
    checked: FitSolverCheck = field(default_factory=FitSolverCheck)
    evidence: ChangeEvidence | None = None

    def __repr__(self) -> str:
        return f"Diagnosis({self.kind}{': ' if self.named else ''}{', '.join(self.named)})"

    def __getitem__(self, name: str) -> FaultHypothesis:
        """Return one hypothesis."""
        for each in self.hypotheses:
            if each.name == name:
                return each
        raise InputError(f"the diagnosis has no fault {name!r}; it has {', '.join(h.name for h in self.hypotheses)}")

    @property
    def kind(self) -> str:
        """What it is.

        ``"fault"``, ``"other"`` (a sensor, the supply or a parameter), ``"ambiguous"`` (which one is open),
        ``"unexplained"``, ``"undecided"`` or ``"healthy"``.
        """
        if self.unexplained.larger and self.unexplained.explained < EXPLAINED_SHARE:
            return "unexplained"
        if self.evidence is not None and self.evidence.alarm:
            if len(self.evidence.explanations) > 1:
                return "ambiguous"
            return "fault" if self.evidence.faults else "other"
        if self.evidence is None and self.called:
            return "fault" if len(self.named) == 1 else "ambiguous"
        open_ = not self.ended or any(not each.ended or each.undetermined for each in self.hypotheses)
        return "undecided" if open_ else "healthy"

    @property
    def table(self) -> pd.DataFrame:
        """One row a size of each hypothesis."""
        rows = [
            {
                "fault": each.name,
                "parameter": size.name,
                "value": size.value,
                "std": size.std,
                "lower": size.interval()[0],
                "upper": size.interval()[1],
                "unit": size.unit,
                "probability": size.probability,
                "angle": size.angle,
                "angle_value": size.angle_value if each.located(size, self.level) else math.nan,
                "angle_std": size.angle_std if each.located(size, self.level) else math.nan,
                "D": each.statistic,
                "threshold": each.threshold,
                "fault_probability": each.adjusted,
                "information": each.information,
                "called": each.name in self.called,
                "named": each.name in self.named,
            }
            for each in self.hypotheses
            for size in each.sizes
        ]
        return pd.DataFrame(rows)

    # --- JSON

    def to_json_dict(self) -> dict[str, Any]:
        """Return the content of ``diagnosis.json``; what is not a finite number is None."""
        content = {
            "kind": self.kind,
            "called": self.called,
            "named": self.named,
            "level": self.level,
            "unexplained": self.unexplained,
            "samples": self.samples,
            "noise_variance": dict(self.noise_variance),
            "nominal": {n: {"value": v, "std": s} for n, (v, s) in self.nominal.items()},
            "ended": self.ended,
            "faults": {each.name: each.to_json_dict(self.level) for each in self.hypotheses},
            "strain": self.strain,
            "evidence": self.evidence,
            "accuracy": self.checked.to_json_dict(),
            "version": self.version,
        }
        plain: dict[str, Any] = as_json(content)
        return plain

    def to_json(self, path: str | Path) -> Path:
        """Write ``diagnosis.json`` and return its path.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        return write_json(Path(path), self.to_json_dict())

    @classmethod
    def from_json(cls, path: str | Path) -> Diagnosis:
        """Read a ``diagnosis.json``; the fits, which are not in it, are None.

        Raises
        ------
        InputError
            If the file cannot be read or is no such file.
        """
        with content_of(Path(path), "the diagnosis.json of a diagnosis", "run fmuid diagnose again") as data:
            return cls(
                level=float(data["level"]),
                hypotheses=tuple(FaultHypothesis.of_json(name, each) for name, each in data["faults"].items()),
                called=tuple(data["called"]),
                named=tuple(data["named"]),
                unexplained=ResidualVarianceTest(**data["unexplained"]),
                samples=int(data["samples"]),
                noise_variance=dict(data["noise_variance"]),
                nominal=estimates_of(data["nominal"]),
                ended=bool(data["ended"]),
                strain=None if data["strain"] is None else BaselineDeviation(**data["strain"]),
                version=str(data["version"]),
                checked=FitSolverCheck.of_json(data.get("accuracy")),
                evidence=None if data["evidence"] is None else ChangeEvidence.of_json(data["evidence"]),
            )
