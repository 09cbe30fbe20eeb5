"""Findings in notebooks: tables as HTML, and the same figures as on the page of a report."""

from __future__ import annotations

import html as markup
from collections.abc import Sequence
from typing import Any

import numpy as np

from fmuid.batches import BatchResult, estimates, is_repetition
from fmuid.data import Experiment
from fmuid.diagnosis import Diagnosis
from fmuid.errors import InputError
from fmuid.estimation import Result, optima_table
from fmuid.fmi import FMU
from fmuid.reports.batch_words import noted
from fmuid.reports.findings import Findings
from fmuid.reports.page.batches import summary_table
from fmuid.reports.page.document import table
from fmuid.reports.page.faults import faults_table
from fmuid.reports.page.identification import estimates_table
from fmuid.reports.words.describe import describe
from fmuid.simulation import Fit
from fmuid.studies import Study
from fmuid.text import has_unit

# Rows of a table; a notebook is no place for ten thousand variables.
MAX_ROWS = 25


# --- tables


def html(found: object) -> str | None:
    """Return what a notebook shows of a finding, a study, a model or a table, as HTML."""
    match found:
        case Findings():
            return _with_words(found.result, estimates_table(found.result, found.result.units, found.level))
        case Result():
            return _with_words(found, estimates_table(found, found.units))
        case Diagnosis():
            return _with_words(found, faults_table(found))
        case Study():
            return _study(found)
        case FMU():
            return _fmu(found)
        case Experiment():
            return _experiment(found)
        case BatchResult():
            head = _heading(f"{found.finished} of {found.total} cases", str(found.folder))
            return head + summary_table(noted(found.summary()[0].parameters))
    return None


def text(found: object) -> str:
    """Return what is printed of a finding."""
    from fmuid.reports.console.result import summary

    return summary(found) if isinstance(found, Result) else repr(found)


def _with_words(found: Result | Diagnosis, rows: str) -> str:
    first, *others = describe(found).split("\n")
    said = "".join(f"<li>{markup.escape(text)}</li>" for text in others)
    return f"<p><b>{markup.escape(first)}</b></p>{rows}<ul>{said}</ul>"


def _heading(name: str, words: str = "") -> str:
    return f"<p><b>{markup.escape(name)}</b> {markup.escape(words)}</p>"


def _study(study: Study) -> str:
    rows = study.parameters.items()
    columns = {
        "parameter": [name for name, _ in rows],
        "start": [f"{each.start:.6g}" for _, each in rows],
        "bounds": [f"{each.min:.6g} to {each.max:.6g}" for _, each in rows],
    }
    tables = ", ".join(
        f"{each.name} ({', '.join(each.inputs)} → {', '.join(each.outputs)})" for each in study.experiments
    )
    return _heading(study.title, tables) + table(columns, numbers=("start", "bounds"))


def _fmu(fmu: FMU) -> str:
    kinds = ("parameter", "input", "output")
    shown = [each for each in fmu.description.variables.values() if each.causality in kinds]
    shown.sort(key=lambda each: kinds.index(str(each.causality)))
    columns = {
        "variable": [each.name for each in shown[:MAX_ROWS]],
        "causality": [str(each.causality) for each in shown[:MAX_ROWS]],
        "start": ["" if each.start is None else str(each.start) for each in shown[:MAX_ROWS]],
        "unit": [str(each.unit) if has_unit(each.unit) else "" for each in shown[:MAX_ROWS]],
    }
    more = f", {len(shown) - MAX_ROWS} more" if len(shown) > MAX_ROWS else ""
    return _heading(fmu.name, f"FMI {fmu.description.fmi_version}{more}") + table(columns, numbers=("start",))


def _experiment(given: Experiment) -> str:
    times = given.times
    names = (*given.input_names, *given.output_names)
    columns = {
        "column": list(names),
        "role": ["input"] * len(given.input_names) + ["output"] * len(given.output_names),
        "unit": [str(unit) if has_unit(unit := given.units.get(name)) else "" for name in names],
    }
    return _heading(given.name, f"{len(times)} samples, {times[0]:g} to {times[-1]:g} s") + table(columns)


# --- figures


class Drawing:
    """Figures that a notebook shows.

    Attributes
    ----------
    models : sequence
        Of Bokeh.
    columns : int
        So many stand beside each other where there is room.
    """

    _library_in: list[str] = []  # noqa: RUF012  # the cell that carries the library of the notebook
    """One figure of a notebook carries the library, 1.3 MB; run again, it carries it again."""

    def __init__(self, models: Sequence[Any], columns: int = 1) -> None:
        self.models, self.columns = models, columns

    def __repr__(self) -> str:
        return f"Drawing of {len(self.models)} figures"

    def _repr_html_(self) -> str:
        """Return the figures, with the library where no cell before has it."""
        from fmuid.reports.page.document import drawn

        library, script, places = drawn(self.models)
        cell = _cell()
        if not self._library_in or (cell and self._library_in == [cell]):
            self._library_in[:] = [cell]
            script = f"{library}\n{script}"
        script = script.replace("</script", "<\\/script")
        width = 100 // self.columns - 1
        cells = "".join(f'<div style="flex:1 1 {width}%;min-width:260px">{place}</div>' for place in places)
        style = "display:flex;flex-wrap:wrap;gap:8px;background:#fff;color:#24292f;padding:8px;border-radius:8px"
        return f'<div style="{style}">{cells}</div><script>{script}</script>'


def _cell() -> str:
    """Return the number of the cell that is run, "" outside of notebooks."""
    try:
        from IPython import get_ipython
    except ImportError:
        return ""
    shell = get_ipython()
    parent = {} if shell is None or not hasattr(shell, "get_parent") else shell.get_parent()
    return str(parent.get("metadata", {}).get("cellId", ""))


def plots(found: object) -> Any:
    """Return the figures of a finding, a method each.

    Raises
    ------
    InputError
        If nothing can be drawn of it.
    """
    match found:
        case Findings():
            return ResultPlots(found.result, found.fits, found)
        case Result():
            return ResultPlots(found, _fits(found))
        case Diagnosis():
            return DiagnosisPlots(found)
        case BatchResult():
            return BatchPlots(found)
    raise InputError(f"a {type(found).__name__} has no figures")


def _fits(result: Result) -> tuple[Fit, ...]:
    """Return measured and simulated outputs of a result, whose units it does not know."""
    fits = []
    for k, frame in enumerate(result.fit):
        names = tuple(
            str(name).removeprefix("measured.") for name in frame.columns if str(name).startswith("measured.")
        )
        measured, simulated = (
            frame[[f"{kind}.{name}" for name in names]].to_numpy(np.float64) for kind in ("measured", "simulated")
        )
        times, counted = frame["time"].to_numpy(np.float64), np.isfinite(measured)
        fits.append(Fit(f"experiment {k + 1}", times, names, (None,) * len(names), measured, simulated, counted))
    return tuple(fits)


class ResultPlots:
    """Figures of an identification: ``found.plot.fit()`` and its like."""

    def __init__(self, result: Result, fits: Sequence[Fit], findings: Findings | None = None) -> None:
        self._result, self._units, self._fits, self._findings = result, result.units, fits, findings

    def fit(self) -> Drawing:
        """Measured and simulated outputs, the residual below."""
        from fmuid.reports.interactive import fit

        self._kept(bool(self._fits))
        return Drawing([fit.fit(record) for record in fit.worst(self._fits)])

    def residuals(self) -> Drawing:
        """Distribution of each residual; of `Findings` its autocorrelation and correlation with the inputs too."""
        from fmuid.reports.interactive import residuals

        self._kept(bool(self._fits))
        drawn: list[Any] = []
        for record in self._fits:
            for j, output in enumerate(record.outputs):
                values = np.where(record.counted[:, j], record.measured[:, j] - record.simulated[:, j], np.nan)
                drawn.append(residuals.histogram(values, output))
        if self._findings is not None:
            table_ = self._findings.diagnostics.correlations
            for key, rows in table_.groupby(["experiment", "output"], sort=False):
                output = str(key[1]) if isinstance(key, tuple) else ""
                own, others = rows[rows["with"] == output], rows[rows["with"] != output]
                drawn.append(residuals.autocorrelation(own, output))
                drawn += [residuals.with_inputs(others, output)] if len(others) else []
        return Drawing(drawn, 3)

    def search(self) -> Drawing:
        """Parameters and criterion against the iteration."""
        from fmuid.reports.interactive import search

        trace = self._result.trace
        self._kept(len(trace) > 0)
        table_ = self._result.to_frame().reset_index()
        return Drawing([*search.parameters(trace, table_), *search.criterion(trace)], 3)

    def optima(self) -> Drawing:
        """Where the searches of the whole box ended."""
        from fmuid.reports.interactive import search

        self._kept(bool(self._result.optima))
        return Drawing(search.optima(optima_table(self._result.names, self._result.optima), self._units), 3)

    def correlation(self) -> Drawing:
        """Correlation matrix and confidence ellipses."""
        from fmuid.reports.interactive import estimates as drawn

        return Drawing([drawn.correlation(self._result.correlation), *drawn.ellipses(self._result, self._units)], 3)

    def accuracy(self) -> Drawing:
        """Shift of each estimate under a finer simulation."""
        from fmuid.reports.interactive import estimates as drawn

        return Drawing([drawn.accuracy(self._result.to_frame().reset_index())])

    def belief(self) -> Drawing:
        """Prior, data alone, and both; of `Findings` only."""
        from fmuid.reports.interactive import estimates as drawn

        if self._findings is None:
            raise InputError("what the data alone say is in the findings of fmuid.run_study: draw them")
        return Drawing(drawn.belief(self._findings.reading.table, self._units), 3)

    def parabolas(self, *names: str) -> Drawing:
        """Criterion of prior, data and both over parameters, default all with a prior; of `Findings` only."""
        from fmuid.reports.interactive import estimates as drawn

        if self._findings is None:
            raise InputError("what the data alone say is in the findings of fmuid.run_study: draw them")
        return Drawing(drawn.parabolas(self._findings.reading.table, names, self._units), 3)

    def _kept(self, there: bool) -> None:
        if not there:
            raise InputError("this result has nothing of it: one read from a file has neither trace nor fit")


class DiagnosisPlots:
    """Figures of a diagnosis: ``found.plot.evidence()`` and its like."""

    def __init__(self, found: Diagnosis) -> None:
        self._found = found

    def evidence(self) -> Drawing:
        """By how much each fault lowers the criterion, against its threshold."""
        from fmuid.reports.interactive import diagnosis

        return Drawing([diagnosis.evidence(self._found)])

    def sizes(self) -> Drawing:
        """Sizes of each fault with their intervals."""
        from fmuid.reports.interactive import diagnosis

        return Drawing(diagnosis.sizes(self._found), 2)


class BatchPlots:
    """Figures of a batch: ``found.plot.cases()`` and its like."""

    def __init__(self, found: BatchResult) -> None:
        self._found = found

    def cases(self) -> Drawing:
        """Estimates over the cases."""
        from fmuid.reports.interactive import batch

        return Drawing(batch.over_cases(self._found.frame, self._found.truth, dict(self._found.units)), 2)

    def distributions(self) -> Drawing:
        """How the estimates are distributed, beside what their stated std promises."""
        from fmuid.batches import Columns
        from fmuid.reports.interactive import batch

        frame = self._found.frame
        found = estimates(frame, given_noise=self._found.given_noise)
        repeated = is_repetition(found, Columns.of(frame))
        return Drawing(batch.distributions(found, self._found.truth, dict(self._found.units), repeated=repeated), 3)

    def spread(self) -> Drawing:
        """Spread over the cases against the stated std."""
        from fmuid.reports.interactive import batch

        return Drawing([batch.spread(self._found.summary()[0].parameters)])
