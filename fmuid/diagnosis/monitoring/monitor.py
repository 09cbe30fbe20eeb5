"""Monitoring: a long record, or one record after the other, window by window, and an alarm where a fault stays.

Every window is fitted by itself with what the healthy machine showed as prior, or with what the window before left,
part of it forgotten (`fmuid.diagnosis.monitoring.window_fit`); the common mode follows what is foreseen, as a
temperature. A window is significant where D exceeds its threshold at the chosen level (`fmuid.diagnosis.decision`). One
window in 1/level is so without a fault: an alarm takes several of the last few.

Each window is simulated from a little earlier on, longer than a transient, so that its unknown initial state is
forgotten and no sample is lost (docs/method.md section 5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from fmuid.assessment import SAME_VARIANCE_RATIO
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.decision import at_least_one, rivals
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.hypothesis import Size
from fmuid.diagnosis.monitoring.alarms import Alarm, Rule, alarm_rate, alarms
from fmuid.diagnosis.monitoring.belief import Belief, forgotten
from fmuid.diagnosis.monitoring.window_fit import Extended, WindowFit
from fmuid.diagnosis.monitoring.windows import cut, end_of, part_of
from fmuid.diagnosis.procedure import UNEXPLAINED_SHARE
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Result
from fmuid.files import content_of, is_file, write_json, write_table
from fmuid.progress import Progress, WindowStep
from fmuid.simulation import Simulator
from fmuid.version import __version__

TABLE_FILE, STATE_FILE = "monitoring.csv", "monitoring.json"

# The verdict names sizes that are so many standard deviations from zero.
STANDS_OUT_STDS = 3.0
# Simulations from an early and from a late start agree after the transient to this share of the noise's deviation.
TRANSIENT_SHARE = 0.2


@dataclass(frozen=True)
class Gap:
    """A window of a record in which no sample of some output counts.

    Attributes
    ----------
    source : str
        Of the record.
    time : float
        Where the window begins, s.
    """

    source: str
    time: float


class Monitor:
    """Watches records for faults, window by window.

    Parameters
    ----------
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    hypotheses : mapping of str to Fault
    rule : Rule

    Attributes
    ----------
    rule : Rule
    models : tuple of Extended
        One a fault.
    gaps : tuple of Gap
        Windows that are left out.

    Raises
    ------
    InputError
        If there is no hypothesis, or the healthy result does not fit the model.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> rule = fmuid.Rule(needed=1, among=1)  # the whole record is one window
    >>> monitor = fmuid.Monitor(fmuid.identify(coil.problem()), {"turns": turns}, rule)
    >>> _ = monitor.add(test.experiment)
    >>> [alarm.fault for alarm in monitor.alarms]
    ['turns']
    """

    def __init__(self, baseline: Baseline | Result | str | Path, hypotheses: Mapping[str, Fault], rule: Rule) -> None:
        if not hypotheses:
            raise InputError("there is no fault to look for: give at least one fault model with its parameters")
        healthy = Baseline.of(baseline)
        self._freedom, self.rule = healthy.freedom, rule
        self.models = tuple(
            Extended(name, fault, healthy.common, healthy.variances, self._freedom, healthy.refinement)
            for name, fault in hypotheses.items()
        )
        self.gaps: tuple[Gap, ...] = ()
        self._rows: list[dict[str, Any]] = []
        self._beliefs = {model.name: model.prior for model in self.models}
        self._points = {model.name: model.prior.mean for model in self.models}

    def add(self, record: Experiment, progress: Progress | None = None) -> pd.DataFrame:
        """Fit the windows of a record and return their rows of the table; what goes wrong leaves everything as it was.

        Parameters
        ----------
        record : Experiment
            With the healthy machine's names; what it discards is left out at its beginning.
        progress : callable, optional
            Called with a `fmuid.progress.WindowStep` before each window.

        Raises
        ------
        InputError
            If a record of this name is there already, it is shorter than a window, has other inputs or outputs than
            the model, or its transient lasts longer than the rule says.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        if record.name in self.records:
            raise InputError(
                f"{record.source}: a record named {record.name!r} has been monitored already: leave it out or rename it"
            )
        before = dict(self._beliefs), dict(self._points), len(self._rows)
        try:
            self._examine(record, progress)
        except BaseException:
            self._beliefs, self._points = before[:2]
            del self._rows[before[2] :]
            raise
        return self.table.iloc[before[2] :]

    def _examine(self, record: Experiment, progress: Progress | None) -> None:
        windows = cut(record, self.rule.window, self.rule.transient)
        renamed = [model.fault.renamed(record) for model in self.models]
        simulators: list[Simulator | None] = [None] * len(self.models)
        first = len(self._rows)
        for number, (lead, start, stop) in enumerate(windows):
            if progress is not None:
                progress(WindowStep(record=record.name, number=number, total=len(windows)))
            fits = {}
            for k, (model, own) in enumerate(zip(self.models, renamed, strict=True)):
                part = part_of(own, lead, start, stop, record.discard if number == 0 else 0.0, self.rule.transient)
                if part is None:
                    break
                earlier = simulators[k]
                simulator = model.simulator(part) if earlier is None else earlier.over(part)
                simulators[k] = simulator
                if number == 1:
                    self._check_transient(model, simulator, part_of(own, windows[0][0], start, stop, 0.0, 0.0))
                fits[model.name] = self._fit(model, simulator)
            else:
                span = float(record.times[start]), end_of(record.times, stop)
                self._rows.append(self._row(record.name, number, span, fits))
                continue
            self.gaps += (Gap(record.source, float(record.times[start])),)
        if len(self._rows) == first:
            raise InputError(
                f"{record.source} leaves no window in which every output has a sample that counts: make the transient "
                "or what the study discards shorter, or leave the record out"
            )

    def _check_transient(self, model: Extended, simulator: Simulator, whole: Experiment | None) -> None:
        """Compare the simulation from a little before a window with that from the beginning of the record."""
        assert whole is not None  # it has the samples of the window
        point, experiment = self._points[model.name], simulator.experiment
        theta = model.thetas(point[None])[0]
        late, early = simulator(theta), simulator.over(whole)(theta)[-experiment.times.size :]
        off = np.abs(late - early)[experiment.counted] * model.weights(experiment)
        if off.max(initial=0.0) > TRANSIENT_SHARE:
            raise InputError(
                f"{experiment.source}: the transient lasts longer than {self.rule.transient:g} s: what a simulation "
                f"starts from still shows then, by {off.max():.2g} standard deviations of the noise; "
                "give a longer transient, and windows longer than that"
            )

    def _fit(self, model: Extended, simulator: Simulator) -> WindowFit:
        name = model.name
        prior = forgotten(self._beliefs[name], model.prior, self.rule.forgetting)
        try:
            found = model.fit(simulator, self._points[name], prior)
        except SimulationError:
            found = None
        if found is None or not found.ended:
            again = model.fit(simulator, model.prior.mean, prior)
            found = again if found is None or again.ended else found
        self._beliefs[name] = found.belief
        self._points[name] = found.point if found.ended else model.prior.mean
        return found

    def _row(
        self, record: str, number: int, span: tuple[float, float], fits: Mapping[str, WindowFit]
    ) -> dict[str, Any]:
        """Decide, and return the row of a window."""
        chances = [fit.reference.probability(fit.statistic) for fit in fits.values()]
        adjusted = at_least_one(chances)
        samples = next(iter(fits.values())).samples
        information = [fit.active * math.log(samples) - fit.statistic for fit in fits.values()]
        called = [i for i, p in enumerate(adjusted) if p <= self.rule.level]
        best = [called[i] for i in rivals([information[i] for i in called])] if called else []
        fit = list(fits.values())[best[0] if best else int(np.argmin(information))]
        ratio = fit.squares / fit.samples
        larger = special.fdtrc(fit.samples, self._freedom, ratio) if math.isfinite(self._freedom) else None
        chance = float(special.chdtrc(fit.samples, fit.squares) if larger is None else larger)
        names = list(fits)
        row: dict[str, Any] = {
            "record": record,
            "window": number,
            "start": span[0],
            "end": span[1],
            "samples": samples,
            "significant": " or ".join(names[i] for i in sorted(best)),
            "probability": min(adjusted),
            "variance_ratio": ratio,
            "unexplained": ratio > SAME_VARIANCE_RATIO and chance < UNEXPLAINED_SHARE * self.rule.level,
        }
        for model, p in zip(self.models, chances, strict=True):
            found = fits[model.name]
            for name, value, std in zip(model.names, found.values.tolist(), found.std.tolist(), strict=True):
                row |= {f"{model.name}.{name}": value, f"{model.name}.{name}.std": std}
            row |= {f"{model.name}.{word}": value for word, value in _words(found, p).items()}
        return row

    # --- what was found

    @property
    def table(self) -> pd.DataFrame:
        """One row a window.

        ``start``, ``end`` (s), ``samples``; ``significant``: the fault, "" without; its ``probability`` without a
        fault, for all faults together; ``variance_ratio`` of residual and noise; ``unexplained``: it is larger;
        ``alarm``: the fault that stays, "" without; and for each fault its parameters and the common mode with
        ``.std``, ``.D``, ``.probability``, ``.share`` (of the variance, the healthy record's), ``.colour`` (by how much
        the residual's colour widens the scatter) and ``.ended``.
        """
        frame = pd.DataFrame(self._rows)
        if len(frame):
            frame.insert(9, "alarm", alarms(frame["significant"].tolist(), frame["unexplained"].tolist(), self.rule))
        return frame

    @property
    def records(self) -> tuple[str, ...]:
        """The names of the records."""
        return tuple(dict.fromkeys(row["record"] for row in self._rows))

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The alarms, in their order."""
        table = self.table
        if table.empty:
            return ()
        found, raised = [], table["alarm"].tolist()
        for i, name in enumerate(raised):
            if name and (i == 0 or raised[i - 1] != name):
                last = next((j for j in range(i, len(raised)) if raised[j] != name), len(raised)) - 1
                found.append(Alarm(name, table["record"][i], float(table["end"][i]), i, last))
        return tuple(found)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The faults that no window determines."""
        table = self.table
        first = {each.name: f"{each.name}.{each.fault.sizes[0]}.std" for each in self.models}
        return tuple(name for name, std in first.items() if len(table) and np.isinf(table[std]).all())

    def standing_out(self, alarm: Alarm) -> tuple[Size, ...]:
        """Return the sizes that stand out in the last window of an alarm in which its fault is significant.

        At least the one that does most; of faults that are not told apart those of the first one.
        """
        table, fault = self.table, alarm.fault.split(" or ")[0]
        row = table.iloc[max(i for i in range(alarm.last + 1) if table["significant"][i] == alarm.fault)]
        model = next(each for each in self.models if each.name == fault)
        found = {name: (float(row[f"{fault}.{name}"]), float(row[f"{fault}.{name}.std"])) for name in model.fault.sizes}
        ratios = {name: abs(value) / std for name, (value, std) in found.items()}
        kept = [name for name in ratios if ratios[name] >= min(STANDS_OUT_STDS, max(ratios.values()))]
        return tuple(Size(name, *found[name], model.system.unit(name) or "", math.nan) for name in kept)

    def false_alarm_rates(self) -> tuple[float, float]:
        """Return the probability that a window of a healthy machine is in alarm: over all healthy records, and at most.

        The first takes the windows' noise for independent and counts the healthy record's errors, which all windows
        share; it is nan with forgetting, where windows share data too. The second holds whatever they share.
        """
        limit = min(1.0, self.rule.level * self.rule.among / self.rule.needed)
        table = self.table
        if self.rule.forgetting or table.empty:
            return math.nan, limit
        level = self.rule.level / len(self.models)
        rates = [
            alarm_rate(
                level,
                self.rule.needed,
                self.rule.among,
                share=float(table[f"{model.name}.share"].median()),
                two_sided=not model.fault.constrained,
            )
            for model in self.models
        ]
        return min(sum(rates), limit), limit

    # --- files

    def write(self, folder: str | Path, also: Mapping[str, Any] | None = None) -> list[Path]:
        """Write ``monitoring.csv`` and ``monitoring.json``, which has what `resume` needs, and return their paths.

        Parameters
        ----------
        folder : path
        also : mapping, optional
            What else the JSON file is to say.
        """
        folder = Path(folder)
        rates = self.false_alarm_rates()
        content = {
            "alarms": self.alarms,
            "false_alarm_rate": rates[0],
            "false_alarm_rate_at_most": rates[1],
            "rule": self.rule,
            "priors": {model.name: model.prior for model in self.models},
            "names": {model.name: list(model.names) for model in self.models},
            "sizes": {model.name: list(model.fault.sizes) for model in self.models},
            "units": {each.name: {name: each.system.unit(name) for name in each.names} for each in self.models},
            "beliefs": self._beliefs,
            "points": self._points,
            "windows": len(self._rows),
            "version": __version__,
            **(also or {}),
        }
        return [write_json(folder / STATE_FILE, content), write_table(folder / TABLE_FILE, self.table)]

    def resume(self, folder: str | Path) -> None:
        """Go on where an earlier run ended, whose files are in a folder.

        Raises
        ------
        InputError
            If there is none, or it had another rule, other faults or another healthy machine.
        """
        path, remedy = Path(folder) / STATE_FILE, "monitor without appending"
        if not is_file(path):
            raise InputError(f"{folder} has no earlier run to append to: {remedy} first")
        with content_of(path, "the monitoring.json of fmuid monitor", remedy) as content:
            same = content["rule"] == asdict(self.rule)
            same &= content["names"] == {model.name: list(model.names) for model in self.models}
            priors = content["priors"]
            if not same or not all(Belief.of_json(priors[each.name]).like(each.prior) for each in self.models):
                raise InputError(
                    f"{path} is of a run with another rule, other faults or another healthy machine: use the same, or "
                    "another output folder"
                )
            beliefs = {model.name: Belief.of_json(content["beliefs"][model.name]) for model in self.models}
            points = {model.name: np.array(content["points"][model.name], np.float64) for model in self.models}
            windows = int(content["windows"])
        self._rows = _rows(path.with_name(TABLE_FILE), windows, remedy)
        self._beliefs, self._points = beliefs, points


def _rows(path: Path, count: int, remedy: str) -> list[dict[str, Any]]:
    """Return the rows of a written table, which must be so many."""
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False).drop(columns="alarm")
        if len(table) != count or table.isna().to_numpy().any():
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
        return [{str(key): _cell(str(key), text) for key, text in row.items()} for row in table.to_dict("records")]
    except (OSError, KeyError, ValueError) as error:
        said = str(error).splitlines()[0]
        raise InputError(f"{path} is no table of fmuid monitor, or not whole ({said}): {remedy}") from None


def _cell(column: str, text: str) -> Any:
    """Return a cell of a written table; Python reads numbers back exactly, as tables are not always."""
    if column in ("record", "significant"):
        return text
    if column in ("window", "samples"):
        return int(text)
    return text == "True" if column == "unexplained" or column.endswith(".ended") else float(text)


def _words(fit: WindowFit, probability: float) -> dict[str, Any]:
    return {
        "D": fit.statistic,
        "probability": probability,
        "share": fit.share,
        "colour": fit.colour,
        "ended": fit.ended,
    }
