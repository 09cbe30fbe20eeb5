"""The optimization: parameters, cost, λ, noise variances, local optima."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pandas as pd

from fmuid.estimation import Result
from fmuid.formatting import counted, has_unit, label
from fmuid.identification import EQUAL_COST
from fmuid.reports.chart import LIMITS, Axis, Chart, Data, Layer, Units, kinds, named, picked
from fmuid.reports.document import DETAIL, Message, Remark, Section, doubt, plain, table_of

WIDE_RANGE = 5.0  # variances and costs are drawn logarithmically where they range over this ratio
PARAMETERS = (
    "Each parameter should settle in the blue band, the interval of its estimate. Amber: prior ± 2 σ. Circle: initial "
    "guess."
)
COST = (
    "The cost decreases with each accepted step; crosses are rejected trials. It restarts where the noise variances "
    "are estimated again."
)
OPTIMA = (
    "Optima from starting points of the whole box; larger points were found more often. Several low points apart from "
    "each other fit equally well."
)


class OptimaMessage(Message, section="optima"):
    """Optima of a global search."""

    SECOND = doubt(
        "Second optimum fits equally well: {values} (cost + {excess}).",
        "the data do not distinguish them",
        "Narrow the bounds or add a prior.",
    )
    FOUND = plain("{count} from {searches}; best one found {hits} ×.")


def optima_remarks(result: Result) -> list[Remark]:
    """Return the number of local optima, and those that fit equally well."""
    shown = result.history.optima
    if not shown:
        return []
    searches = sum(optimum.hits for optimum in shown)
    count = f"{len(shown)} optim{'um' if len(shown) == 1 else 'a'}"
    said = [OptimaMessage.FOUND.said(count=count, searches=counted(searches, "starting point"), hits=shown[0].hits)]
    for other in shown[1:]:
        if (excess := other.criterion - shown[0].criterion) < EQUAL_COST:
            pairs = zip(result.names, other.theta.tolist(), strict=True)
            values = ", ".join(f"{name} = {value:.5g}" for name, value in pairs)
            said.append(OptimaMessage.SECOND.said(values=values, excess=f"{excess:.2g}"))
    return said


def optima_section(result: Result) -> Section:
    """Return the table of the local optima."""
    shown = result.history.optima
    values = {name: [f"{optimum.theta[i]:.5g}" for optimum in shown] for i, name in enumerate(result.names)}
    columns = {
        "cost": [f"{optimum.criterion:.6g}" for optimum in shown],
        "found": [f"{optimum.hits} ×" for optimum in shown],
        **values,
        "note": ["" if optimum.converged else "not converged" for optimum in shown],
    }
    return Section("found", "Optima", table=table_of(columns, ["note"], result.names[::-1]), shown=DETAIL)


def optimization_sections(
    result: Result, estimates: pd.DataFrame, optima: pd.DataFrame, output_units: Units
) -> list[Section]:
    """Return the charts of an optimization."""
    sections, trace, rounds = [], result.trace, pd.DataFrame(result.history.rounds)
    if len(trace):
        drawn = tuple(_parameters(trace, estimates))
        sections.append(Section("parameters", "Parameters during the optimization", PARAMETERS, charts=drawn))
        curves = _criterion(trace) + (_rounds(rounds, output_units) if len(rounds) > 1 else [])
        sections.append(Section("cost", "Cost during the optimization", COST, charts=tuple(curves)))
    if len(optima):
        units = dict(zip(estimates["parameter"], estimates["unit"], strict=True))
        sections.append(Section("optima", "Optima", OPTIMA, charts=tuple(_optima(optima, units))))
    return sections


def _iterations(trace: pd.DataFrame) -> Axis:
    last = float(trace["iteration"].max())
    return Axis("iteration", reach=(-0.03 * last - 0.15, 1.03 * last + 0.15), linked="iterations", whole=True)


def _parameters(trace: pd.DataFrame, estimates: pd.DataFrame) -> list[Chart]:
    accepted = trace[trace["accepted"].astype(bool)]
    iterations, cost = (accepted[name].to_numpy(np.float64) for name in ("iteration", "cost"))
    across, charts = _iterations(trace), []
    hover = (("iteration", "@x"), ("value", "@y{0.000000}"), ("cost", "@c{0.000}"))
    for row in estimates.iloc[: LIMITS.parameters].to_dict("records"):
        values, layers = accepted[str(row["parameter"])].to_numpy(np.float64), []
        half = 2.0 * float(row["prior_std"])
        if math.isfinite(half):
            prior = {"bottom": row["prior_mean"] - half, "top": row["prior_mean"] + half}
            layers.append(Layer("zone", prior, "amber", alpha=0.18))
        if math.isfinite(row["lower"]) and math.isfinite(row["upper"]):
            layers.append(Layer("zone", {"bottom": row["lower"], "top": row["upper"]}, alpha=0.18))
        data: Data = {"x": iterations, "y": values, "c": cost}
        layers += [
            Layer("rule", {"y": float(row["value"])}, dash="dashed"),
            Layer("line", data),
            Layer("points", data, hover=hover),
            Layer("points", {"x": iterations[:1], "y": values[:1]}, "white", size=8, edge="ink"),
        ]
        reach = _room([*values, row["value"], row["prior_mean"]], row["std"])
        name = label(str(row["parameter"]), row["unit"])
        charts.append(Chart(across, Axis(name, reach=reach), tuple(layers)))
    return charts


def _room(values: list[float], std: float) -> tuple[float, float]:
    """Return limits around values, or around σ if they are equal."""
    known = [value for value in values if math.isfinite(value)]
    low, high = min(known), max(known)
    still = 2.5 * std if math.isfinite(std) and std > 0 else 0.05 * abs(low) or 1.0
    room = 0.12 * (high - low) or still
    return low - room, high + room


def _criterion(trace: pd.DataFrame) -> list[Chart]:
    """Return cost and damping over the iterations, one line per round."""
    damped, across = trace[trace["damping"] > 0], _iterations(trace)
    found = [_curve(trace, "cost", "cost", across)]
    return found + ([_curve(damped, "damping", "damping λ, where not 0", across)] if len(damped) else [])


def _curve(trace: pd.DataFrame, column: str, text: str, across: Axis) -> Chart:
    layers: list[Layer] = []
    for number, (_, part) in enumerate(trace.groupby("round")):
        taken = part["accepted"].to_numpy(bool)
        data = {"x": part["iteration"].to_numpy(np.float64), "y": part[column].to_numpy(np.float64)}
        some = picked(data, taken)
        layers.append(Layer("line", some, label="accepted"))
        hover = (("iteration", "@x"), (text, "@y{0.0000}"))
        layers.append(Layer("points", some, label="accepted", hover=hover))
        refused = ~taken & np.isfinite(data["y"])
        if refused.any():
            look = Layer("points", picked(data, refused), "red", marker="x", size=8, width=1.6, label="rejected trial")
            layers.append(look)
        if number and column == "cost":
            layers.append(Layer("rule", {"x": float(part["iteration"].iloc[0])}, "amber", dash="dashed"))
    return Chart(across, Axis(text, "log"), tuple(layers))


def _rounds(found: pd.DataFrame, units: Units) -> list[Chart]:
    """Return the noise variances over the rounds, the initial ones at 0."""
    outputs = [str(name).removeprefix("used.") for name in found.columns if str(name).startswith("used.")]
    charts = []
    for output in outputs[: LIMITS.parameters]:
        used, estimated = (found[f"{kind}.{output}"].to_numpy(np.float64) for kind in ("used", "estimated"))
        values = np.array([used[0], *estimated])
        unit = units.get(output)
        text = label(f"noise variance of {output}", f"{unit}²" if has_unit(unit) else None)
        wide = values.max() > WIDE_RANGE * values.min() > 0
        data: Data = {"x": np.arange(values.size, dtype=np.float64), "y": values}
        hover = (("round", "@x"), ("variance", "@y{0.00000000}"))
        layers = (Layer("line", data), Layer("points", data, hover=hover))
        charts.append(Chart(Axis("round", whole=True), Axis(text, "log" if wide else "linear"), layers))
    return charts


def _optima(table: pd.DataFrame, units: Units) -> list[Chart]:
    sure, values = table["converged"].to_numpy(bool), table["cost"].to_numpy(np.float64)
    hits, best = table["hits"].to_numpy(np.float64), np.arange(len(table)) == 0
    wide: Literal["linear", "log"] = "log" if values.max() > WIDE_RANGE * values.min() > 0 else "linear"
    hover, charts = (("value", "@x{0.000000}"), ("cost", "@y{0.000}"), ("starting points", "@n")), []
    for name in [str(name) for name in table.columns.drop(["cost", "hits", "converged"])][: LIMITS.parameters]:
        sizes = 6.0 + 10.0 * hits / hits.max()  # diameters in pixels
        data: Data = {"x": table[name].to_numpy(np.float64), "y": values, "size": sizes, "n": hits}
        layers = [
            *kinds("points", data, [("optimum", "blue", sure & ~best)], edge="grey", hover=hover),
            *kinds("points", data, [("not converged", "red", ~sure)], marker="x", hover=hover),
            *kinds("points", data, [("best", "amber", best)], edge="grey", hover=hover),
        ]
        charts.append(Chart(Axis(named(name, units)), Axis("cost", wide), tuple(layers)))
    return charts
