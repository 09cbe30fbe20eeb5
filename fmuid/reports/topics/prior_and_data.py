"""Prior and data: their influence on a result, and their conflict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.estimation import TerminationReason
from fmuid.formatting import listed, two_digits, unit_text, with_std, with_unit
from fmuid.identification import (
    Deviation,
    ExtrapolationReason,
    PriorDataComparison,
    PriorDataTest,
    PriorInfluence,
    parabolas,
    parameters_with_prior_and_data,
)
from fmuid.reports.chart import DENSITY, LIMITS, Axis, Chart, Color, Layer, Units, named, normal
from fmuid.reports.document import CONSOLE, Section, Table, table_of
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.termination import ENDS


def reading_words(reading: PriorDataComparison, units: Mapping[str, str | None] | None = None) -> tuple[str, ...]:
    """Return the remarks on prior, data and known noise."""
    said = [] if reading.agreement is None else [_agreement(reading, reading.agreement)]
    said += [_influence(reading, each) for each in reading.influences]
    said += [_bent(reading)] if reading.bent else []
    said += _variances(reading, units or {})
    said += [obstacle_words(reading.obstacle)] if reading.obstacle is not None else []
    return tuple(said)


def _agreement(reading: PriorDataComparison, agreement: PriorDataTest) -> str:
    chance = (
        f"χ² {agreement.statistic:.3g} with {agreement.degrees_of_freedom} degrees of freedom, "
        f"probability {agreement.probability:.2g}"
    )
    if agreement.holds:
        return f"Prior and data agree ({chance})"
    sizes = np.abs(np.nan_to_num(reading.conflict))
    i = int(np.argmax(sizes))
    most = f", most of all on {reading.names[i]}, {sizes[i]:.2g} standard deviations apart" if sizes[i] else ""
    return (
        f"Prior and data disagree ({chance}){most}: the system has changed, the model lacks something, or the prior is "
        "wrong or too sure of itself; the estimate lies between both"
    )


def _influence(reading: PriorDataComparison, found: PriorInfluence) -> str:
    i = reading.names.index(found.name)
    std = float(reading.data_std[i])
    alone = _shown(float(reading.data[i]), std)
    whose = "its own prior" if found.prior == found.name else f"the prior of {found.prior}"
    if found.rests:
        return f"{found.name} rests on {whose}: the data alone say {alone} ± {std:.2g}"
    return (
        f"The prior moved {found.name} from {alone}, which is what the data alone say, to "
        f"{_shown(float(reading.combined[i]), std)}, by {abs(reading.moved[i]):.2g} of its standard "
        f"deviations; {whose} did most of it"
    )


def _bent(reading: PriorDataComparison) -> str:
    i = reading.names.index(reading.bent)
    return (
        f"Between prior and data the model is not linear: their barycentre has {reading.bent} at "
        f"{_shown(float(reading.barycentre[i]), float(reading.combined_std[i]))}, "
        f"{abs(reading.nonlinearity[i]):.2g} standard deviations from its estimate: "
        "the local standard deviations are an order of magnitude; a profile or the posterior tell more"
    )


def _variances(reading: PriorDataComparison, units: Mapping[str, str | None]) -> list[str]:
    blame = "the model or the prior" if np.isfinite(reading.prior_mean).any() else "the model"
    said, outputs = [], [test for test in reading.variances if test.output]
    for test in outputs:
        unit = units.get(test.output)
        levels = " against ".join(with_unit(math.sqrt(each), unit) for each in (test.estimated, test.known))
        if test.deviation is Deviation.LARGER:
            said.append(
                f"The residual of {test.output} is larger than its stated noise level: {levels} (probability "
                f"{test.probability:.2g}): the system has changed, or {blame} is wrong"
            )
        elif test.deviation is Deviation.SMALLER:
            said.append(
                f"The residual of {test.output} is smaller than its stated noise level: {levels}: standard deviations "
                f"follow the stated level and are {two_digits(1.0 / math.sqrt(test.ratio))} times too large"
            )
    if outputs and not said:
        shares = listed([f"{test.ratio:.3g}" for test in outputs])
        which = listed([test.output for test in outputs])
        said.append(
            f"The residual of {which} is as large as the known noise says (variance {shares} times it, probability "
            f"{reading.variances[-1].probability:.2g})"
        )
    return said


def obstacle_words(obstacle: ExtrapolationReason) -> str:
    """Say why the optimum of the data alone is extrapolated."""
    if obstacle.at_bounds:
        return f"The data alone would push {listed(obstacle.at_bounds)} to a bound, so their optimum is extrapolated"
    if obstacle.undetermined:
        what = listed(tuple(map(direction_words, obstacle.undetermined)))
        return f"At the optimum of the data alone {what}, so it is extrapolated"
    if obstacle.outcome is not None:
        why = "interrupted" if obstacle.outcome is TerminationReason.INTERRUPTED else ENDS[obstacle.outcome]
        return f"The search for the optimum of the data alone did not converge, so it is extrapolated: {why}"
    return "With a robust loss the optimum of the data alone is extrapolated"


def _shown(value: float, std: float) -> str:
    """Return a number to the second significant digit of its standard deviation."""
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{decimals}f}" if 0 <= decimals <= 9 else f"{value:.4g}"


BELIEF = (
    "What the prior said, what the data say alone, and both. Prior and data should overlap; where the data's "
    "curve is wide or missing, the estimate rests on the prior."
)
PARABOLAS = (
    "The criterion of what the prior says, of what the data say, and of both, over each parameter with a "
    "prior: the narrower parabola decides where the estimate lies. Where both stands high above zero at its least, "
    "prior and data contradict each other."
)
DENSITY_STDS, WIDEST = 4.0, 12.0
"""Densities are drawn so many standard deviations wide; one wider than this many of the narrowest is cut."""
HEIGHT = 1.05
"""Of a chart of parabolas, in that of the sum."""
PARTS: tuple[tuple[str, str, Color, float], ...] = (
    ("prior", "prior", "amber", 1.4),
    ("data", "data alone", "grey", 1.4),
    ("both", "both", "blue", 2.0),
)


def prior_sections(reading: PriorDataComparison, units: Units) -> list[Section]:
    """Return prior, data and both: table, densities, cost."""
    table = reading.table
    return [
        Section("reading", "Prior and data", table=_table(reading, units), shown=CONSOLE),
        Section("belief", "Prior, data, and both", BELIEF, charts=tuple(_beliefs(table, units))),
        Section(
            "parabolas",
            "The criterion of prior, data, and both",
            PARABOLAS,
            charts=tuple(parabola_charts(table, (), units)),
        ),
    ]


def _table(reading: PriorDataComparison, units: Units) -> Table:
    rows = {
        "prior": (reading.prior_mean, reading.prior_std),
        "data alone": (reading.data, reading.data_std),
        "both": (reading.combined, reading.combined_std),
    }
    columns: dict[str, list[str]] = {"parameter": list(reading.names)}
    for head, (values, stds) in rows.items():
        columns[head] = [_known(*pair) for pair in zip(values.tolist(), stds.tolist(), strict=True)]
    columns["pull"] = [f"{pull:+z.2f} std" if math.isfinite(pull) else "" for pull in reading.pull.tolist()]
    moves = zip(reading.moved.tolist(), reading.moved_by, strict=True)
    columns["moved by prior"] = [
        f"{moved:+z.2f} std ({by})" if math.isfinite(moved) and by else "" for moved, by in moves
    ]
    columns["unit"] = [unit_text(units.get(name)) for name in reading.names]
    return table_of(columns, [head for head in columns if head != "pull"], ("unit", "moved by prior"))


def _known(value: float, std: float) -> str:
    if not math.isfinite(value):
        return ""
    return with_std(value, std) if std < math.inf else "not determined"


def _beliefs(table: pd.DataFrame, units: Units) -> Iterator[Chart]:
    columns = (("prior", "prior_std"), ("data", "data_std"), ("combined", "combined_std"))
    for row in table.iloc[: LIMITS.parameters].to_dict("records"):
        pairs = [(float(row[mean]), float(row[std])) for mean, std in columns]
        known = [math.isfinite(mean) and math.isfinite(std) and std > 0 for mean, std in pairs]
        if not any(known):
            continue
        narrowest = min(std for (_, std), there in zip(pairs, known, strict=True) if there)
        layers = []
        for (mean, std), there, (_, text, color, width) in zip(pairs, known, PARTS, strict=True):
            if there:
                half = min(DENSITY_STDS * std, WIDEST * narrowest)
                grid = np.linspace(mean - half, mean + half, 161)
                density = normal(grid, mean, std)
                layers.append(Layer("band", {"x": grid, "y0": 0 * grid, "y1": density}, color, alpha=0.14, label=text))
                layers.append(Layer("line", {"x": grid, "y": density}, color, width=width, label=text))
        yield Chart(Axis(named(str(row["parameter"]), units), ticks=4), DENSITY, tuple(layers), 210)


def parabola_charts(table: pd.DataFrame, names: Sequence[str] = (), units: Units | None = None) -> Iterator[Chart]:
    """Yield the cost of prior, data and both over parameters."""
    for name in list(names or parameters_with_prior_and_data(table))[: LIMITS.parameters]:
        curves = parabolas(table, name)
        value = curves["value"].to_numpy(np.float64)
        layers = [
            Layer("line", {"x": value, "y": curves[part].to_numpy(np.float64)}, color, width=width, label=text)
            for part, text, color, width in PARTS
            if curves[part].notna().all()
        ]
        reach = (0.0, HEIGHT * float(curves["both"].max()))
        yield Chart(Axis(named(name, units)), Axis("criterion", reach=reach), tuple(layers), 230)
