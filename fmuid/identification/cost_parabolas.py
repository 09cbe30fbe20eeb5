"""The criterion's two parts and their sum over one parameter: the parabolas of the chapter's figure 1.1.

J₀ = ((θ − θ₀)/σ₀)² is what the prior says, J* = ((θ − θ_opt)/σ_opt)² what the data say beyond their least value, and
J_C = ((θ − θ_C)/σ_C)² + (θ_opt − θ₀)²/(σ₀² + σ_opt²) both (1.54, 1.57). With one parameter J_C is their sum; with
several σ_opt and σ_C are those with the best values of all others, and J_C, whose other parameters have priors too, may
lie lower or higher.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from fmuid.errors import InputError
from fmuid.formatting import nearest

# So many standard deviations of the estimate around the three least values.
REACH = 2.5
POINTS = 161


def parabolas(reading: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the criterion of prior, data and both over one parameter.

    Parameters
    ----------
    reading : DataFrame
        `PriorDataComparison.table`, or ``reading.csv``.
    name : str
        A parameter.

    Returns
    -------
    DataFrame
        ``value``, ``prior``, ``data``, ``both``: NaN all over where there is no prior, or the data determine nothing.

    Raises
    ------
    InputError
        If there is no such parameter, or its estimate has no standard deviation.
    """
    known = list(reading["parameter"])
    if name not in known:
        raise InputError(f"parameter {name!r} is not in the reading{nearest(name, known)}; it has {', '.join(known)}")
    row = reading.iloc[known.index(name)]
    parts = {part: (float(row[part]), float(row[f"{part}_std"])) for part in ("prior", "data", "combined")}
    best, std = parts["combined"]
    if not (np.isfinite(best) and 0.0 < std < np.inf):
        raise InputError(f"the estimate of {name!r} has no standard deviation to draw a parabola by")
    least = [mean for mean, spread in parts.values() if np.isfinite(mean) and 0.0 < spread < np.inf]
    grid = np.linspace(min(least) - REACH * std, max(least) + REACH * std, POINTS)
    found = {"value": grid}
    for part, (mean, spread) in parts.items():
        curve = ((grid - mean) / spread) ** 2 if spread < np.inf else np.full(POINTS, np.nan)
        found["both" if part == "combined" else part] = curve
    found["both"] += np.nan_to_num(float(row["conflict"])) ** 2
    return pd.DataFrame(found)


def parameters_with_prior_and_data(reading: pd.DataFrame) -> list[str]:
    """Return the parameters of which prior and data both speak."""
    finite = np.isfinite(reading[["prior_std", "data_std", "combined_std"]].to_numpy(np.float64)).all(axis=1)
    return [str(name) for name in reading["parameter"][finite]]
