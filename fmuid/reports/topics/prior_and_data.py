"""Prior and data: their influence on a result, and their conflict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from fmuid.formatting import listed, rounded, two_digits, unit_text, with_std, with_unit
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
from fmuid.reports.document import DETAIL, Message, Remark, Section, Table, doubt, plain, table_of
from fmuid.reports.topics.termination import ENDS


class PriorMessage(Message, section="belief"):
    """Prior, data and known noise."""

    AGREE = plain("Prior and data agree (p = {probability}).")
    CONFLICT = doubt(
        "Prior and data conflict (p = {probability}){most}.",
        "the estimate is a compromise of both",
        "Check the prior{of}, the model and the machine.",
    )
    DOMINATES = doubt("Prior{of} dominates {name}; data alone give {alone}.")
    MOVED = plain("Prior of {prior} moved {name} from {alone} to {value} ({moved} σ).")
    NONLINEAR = doubt(
        "Linear combination of prior and data gives {name} = {value}, {distance} σ off.",
        remedy='Set `[uncertainty]` profile_likelihood = ["{name}"], or a posterior.',
    )
    LARGER = doubt(
        "Residual of {output} exceeds its noise level: {estimated} against {known} (p = {probability}).",
        remedy="Check the model, the prior and the machine.",
    )
    SMALLER = doubt(
        "Residual of {output} is below its noise level: {estimated} against {known}.",
        remedy="State the right noise level: σ is {factor} × too large.",
    )
    AS_KNOWN = plain("Residual of {outputs} matches its noise level (variance × {ratios}, p = {probability}).")
    EXTRAPOLATED = plain("Optimum of the data alone is extrapolated: {reason}.")


def reading_remarks(reading: PriorDataComparison, units: Units | None = None) -> list[Remark]:
    """Return the remarks on prior, data and known noise."""
    said = [] if reading.agreement is None else [_agreement(reading, reading.agreement)]
    said += [_influence(reading, each) for each in reading.influences]
    said += [_bent(reading)] if reading.bent else []
    said += _variances(reading, units or {})
    return said + ([] if reading.obstacle is None else [obstacle_remark(reading.obstacle)])


def _agreement(reading: PriorDataComparison, agreement: PriorDataTest) -> Remark:
    probability = f"{agreement.probability:.2g}"
    if agreement.holds:
        return PriorMessage.AGREE.said(probability=probability)
    sizes = np.abs(np.nan_to_num(reading.conflict))
    i = int(np.argmax(sizes))
    most, of = (
        (f"; largest for {reading.names[i]} ({sizes[i]:.2g} σ)", f" of {reading.names[i]}") if sizes[i] else ("", "")
    )
    return PriorMessage.CONFLICT.said(probability=probability, most=most, of=of)


def _influence(reading: PriorDataComparison, found: PriorInfluence) -> Remark:
    i = reading.names.index(found.name)
    std = float(reading.data_std[i])
    alone, value = (rounded(float(each[i]), std) for each in (reading.data, reading.combined))
    if found.rests:
        of = "" if found.prior == found.name else f" of {found.prior}"
        return PriorMessage.DOMINATES.said(name=found.name, of=of, alone=f"{alone} ± {std:.2g}")
    values = {"name": found.name, "prior": found.prior, "alone": alone, "value": value}
    return PriorMessage.MOVED.said(**values, moved=f"{abs(reading.moved[i]):.2g}")


def _bent(reading: PriorDataComparison) -> Remark:
    i = reading.names.index(reading.bent)
    value = rounded(float(reading.weighted_mean[i]), float(reading.combined_std[i]))
    distance = f"{abs(reading.nonlinearity[i]):.2g}"
    return PriorMessage.NONLINEAR.said(name=reading.bent, value=value, distance=distance)


def _variances(reading: PriorDataComparison, units: Units) -> list[Remark]:
    said, outputs = [], [test for test in reading.variances if test.output]
    for test in outputs:
        unit = units.get(test.output)
        values = {key: with_unit(math.sqrt(getattr(test, key)), unit) for key in ("estimated", "known")}
        values |= {"output": test.output, "probability": f"{test.probability:.2g}"}
        if test.deviation is Deviation.LARGER:
            said.append(PriorMessage.LARGER.said(**values))
        elif test.deviation is Deviation.SMALLER:
            values["factor"] = two_digits(1.0 / math.sqrt(test.ratio))
            said.append(PriorMessage.SMALLER.said(**values))
    if outputs and not said:
        ratios, names = listed([f"{test.ratio:.3g}" for test in outputs]), listed([test.output for test in outputs])
        probability = f"{reading.variances[-1].probability:.2g}"
        said.append(PriorMessage.AS_KNOWN.said(outputs=names, ratios=ratios, probability=probability))
    return said


def obstacle_remark(obstacle: ExtrapolationReason) -> Remark:
    """Return why the optimum of the data alone is extrapolated."""
    names = list(dict.fromkeys(name for each in obstacle.undetermined for name in each.names))
    if obstacle.at_bounds:
        reason = f"{listed(obstacle.at_bounds)} would reach a bound"
    elif names:
        reason = f"{listed(names)} not identifiable"
    else:
        reason = "robust loss" if obstacle.outcome is None else ENDS[obstacle.outcome]
    return PriorMessage.EXTRAPOLATED.said(reason=reason)


BELIEF = (
    "Prior, data alone, and both. Prior and data should overlap. Where the data's curve is wide or missing, the prior "
    "dominates the estimate."
)
PARABOLAS = (
    "Cost of prior, data and both over each parameter with a prior. The narrower parabola dominates the estimate. A "
    "minimum of both that is far above zero shows a conflict of prior and data."
)
PARTS: tuple[tuple[str, str, Color, float], ...] = (
    ("prior", "prior", "amber", 1.4),
    ("data", "data alone", "grey", 1.4),
    ("both", "both", "blue", 2.0),
)


def prior_sections(reading: PriorDataComparison, units: Units) -> list[Section]:
    """Return prior, data and both: table, densities, cost."""
    beliefs, costs = tuple(_beliefs(reading.table, units)), tuple(parabola_charts(reading.table, (), units))
    return [
        Section("reading", "Prior and data", table=_table(reading, units), shown=DETAIL),
        Section("belief", "Prior, data, and both", BELIEF, charts=beliefs),
        Section("parabolas", "Cost of prior, data, and both", PARABOLAS, charts=costs),
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
    columns["distance"] = [f"{pull:+z.2f} σ" if math.isfinite(pull) else "" for pull in reading.pull.tolist()]
    moves = zip(reading.moved.tolist(), reading.moved_by, strict=True)
    columns["moved by prior"] = [
        f"{moved:+z.2f} σ ({by})" if math.isfinite(moved) and by else "" for moved, by in moves
    ]
    columns["unit"] = [unit_text(units.get(name)) for name in reading.names]
    return table_of(columns, [head for head in columns if head != "distance"], ("unit", "moved by prior"))


def _known(value: float, std: float) -> str:
    if not math.isfinite(value):
        return ""
    return with_std(value, std) if std < math.inf else "not identifiable"


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
                half = min(4.0 * std, 12.0 * narrowest)  # wider densities are cut
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
        reach = (0.0, 1.05 * float(curves["both"].max()))
        yield Chart(Axis(named(name, units)), Axis("cost", reach=reach), tuple(layers), 230)
