"""What a diagnosis found, in numbers, words and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.diagnosis.hypothesis import Estimate, Hypothesis, estimates_of
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import replacing
from fmuid.text import listed

# A fault whose model explains less than this share of what exceeds the noise is not what is wrong.
MOSTLY = 0.5


@dataclass(frozen=True)
class Test:
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
class Diagnosis:
    """What a diagnosis found.

    Attributes
    ----------
    level : float
        Probability of an alarm where nothing is wrong.
    hypotheses : tuple of Hypothesis
    called : tuple of str
        The hypotheses that are significant.
    named : tuple of str
        Of these the most likely one, and those that the data do not tell apart from it.
    unexplained : Test
        Whether the residual is larger than the noise even so.
    samples : int
    noise_variance : dict of str to float
    nominal : dict of str to (value, std)
        The healthy model fitted.
    ended : bool
        Whether that fit ended at a minimum.
    notes : tuple of str
    version : str
        Of fmuid.
    result : Result or None
        The fit of the healthy model; not kept in a file.
    """

    level: float
    hypotheses: tuple[Hypothesis, ...]
    called: tuple[str, ...]
    named: tuple[str, ...]
    unexplained: Test
    samples: int
    noise_variance: Mapping[str, float]
    nominal: Mapping[str, Estimate]
    ended: bool
    notes: tuple[str, ...]
    version: str
    result: Result | None = None

    def __getitem__(self, name: str) -> Hypothesis:
        """Return one hypothesis."""
        for each in self.hypotheses:
            if each.name == name:
                return each
        raise InputError(f"the diagnosis has no fault {name!r}; it has {', '.join(h.name for h in self.hypotheses)}")

    @property
    def kind(self) -> str:
        """``"fault"``, ``"ambiguous"`` (which one is open), ``"unexplained"``, ``"undecided"`` or ``"healthy"``."""
        if self.unexplained.larger and self.unexplained.explained < MOSTLY:
            return "unexplained"
        if self.called:
            return "fault" if len(self.named) == 1 else "ambiguous"
        open_ = not self.ended or any(not each.ended or each.undetermined for each in self.hypotheses)
        return "undecided" if open_ else "healthy"

    @property
    def verdict(self) -> str:
        """What it is, in one sentence."""
        named = [self[name] for name in self.named]
        nearest = min(self.hypotheses, key=lambda each: each.probability)
        if self.kind == "unexplained":
            said = (
                f"Something else is wrong: the residual's variance is {self.unexplained.ratio:.3g} times the noise "
                f"of the healthy machine (probability {chance(self.unexplained.probability)})"
            )
            if not named:
                return f"{said}, and no fault that was looked for explains it"
            return f"{said} even with the most likely fault, {named[0].words(self.level)}"
        if self.kind == "fault":
            likely = f"probability without a fault {chance(named[0].adjusted)}"
            return f"Fault found: {named[0].words(self.level)} ({likely}){self._rest()}"
        if self.kind == "ambiguous":
            which = listed([each.name for each in named])
            return (
                f"Fault found, but the data cannot tell {which} apart: "
                + "; or ".join(each.words(self.level) for each in named)
                + self._rest()
            )
        if self.kind == "undecided":
            return f"Whether there is a fault stays open: {self._obstacle()}"
        return (
            f"No fault found at a false-alarm level of {100 * self.level:g} %; the most likely one is "
            f"{nearest.words(self.level)} (probability without a fault {chance(nearest.adjusted)})"
        )

    def _rest(self) -> str:
        """Say what the fault leaves unexplained, "" for nothing."""
        if not self.unexplained.larger:
            return ""
        return (
            f"; its model explains {self.unexplained.explained:.0%} of what exceeds the noise, not all of it: "
            "the size is that of a model that is nearly right"
        )

    def _obstacle(self) -> str:
        if not self.ended:
            return "the search for the healthy model did not end at a minimum"
        each = next(each for each in self.hypotheses if not each.ended or each.undetermined)
        return (
            "; ".join(each.undetermined) if each.undetermined else f"{each.name}: the search did not end at a minimum"
        )

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
            "verdict": self.verdict,
            "kind": self.kind,
            "called": self.called,
            "named": self.named,
            "level": self.level,
            "unexplained": asdict(self.unexplained),
            "samples": self.samples,
            "noise_variance": dict(self.noise_variance),
            "nominal": {n: {"value": v, "std": s} for n, (v, s) in self.nominal.items()},
            "ended": self.ended,
            "faults": {each.name: each.to_json_dict(self.level) for each in self.hypotheses},
            "notes": self.notes,
            "version": self.version,
        }
        plain: dict[str, Any] = _plain(content)
        return plain

    def to_json(self, path: str | Path) -> Path:
        """Write ``diagnosis.json`` and return its path.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        with replacing(Path(path)) as draft:
            draft.write_text(json.dumps(self.to_json_dict(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        return Path(path)

    @classmethod
    def from_json(cls, path: str | Path) -> Diagnosis:
        """Read a ``diagnosis.json``; the fits, which are not in it, are None.

        Raises
        ------
        InputError
            If the file cannot be read or is no such file.
        """
        path = Path(path)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            return cls(
                level=float(data["level"]),
                hypotheses=tuple(Hypothesis.of_json(name, each) for name, each in data["faults"].items()),
                called=tuple(data["called"]),
                named=tuple(data["named"]),
                unexplained=Test(**data["unexplained"]),
                samples=int(data["samples"]),
                noise_variance=dict(data["noise_variance"]),
                nominal=estimates_of(data["nominal"]),
                ended=bool(data["ended"]),
                notes=tuple(data["notes"]),
                version=str(data["version"]),
            )
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
            raise InputError(f"{path} is no diagnosis of fmuid: {what}; give a diagnosis.json") from None


def chance(probability: float) -> str:
    """Return a probability to two digits."""
    return f"{probability:.2g}" if probability > 1e-300 else "below 1e-300"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
