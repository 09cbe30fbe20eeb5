"""How a result came about, as tables that are made when they are asked for: many identifications need none of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.codec import Layout
from fmuid.data import Experiment
from fmuid.estimation.search.loop import Iteration


@dataclass(frozen=True, eq=False)
class History:
    """What an identification went through, and the fit at its end.

    Attributes
    ----------
    names : tuple of str
        The parameters.
    rounds : tuple of mapping
        What each repetition on the noise variances used and found.
    iterations : tuple of (int, Iteration)
        Every step of the search, with the number of its round. Not in ``result.json``, as what follows.
    experiments : tuple of Experiment
    simulated : tuple of (K, n_outputs) arrays
        The outputs of each experiment at the estimate.
    """

    names: tuple[str, ...]
    rounds: tuple[Mapping[str, float], ...]
    iterations: tuple[tuple[int, Iteration], ...] = ()
    experiments: tuple[Experiment, ...] = ()
    simulated: tuple[Floats, ...] = ()

    json_layout: ClassVar = Layout(omitted={"iterations", "experiments", "simulated"})

    def after(self, earlier: History) -> History:
        """Return this history as what followed an earlier one."""
        last, steps = len(earlier.rounds), max((step.number for _, step in earlier.iterations), default=0)
        iterations = tuple((last + n, replace(step, number=steps + step.number)) for n, step in self.iterations)
        rounds = tuple({**each, "round": last + each["round"]} for each in self.rounds)
        return replace(self, iterations=earlier.iterations + iterations, rounds=earlier.rounds + rounds)

    def trace_frame(self) -> pd.DataFrame:
        """Return one row an iteration."""
        steps = [step for _, step in self.iterations]
        columns: dict[str, object] = {
            "round": [number for number, _ in self.iterations],
            "iteration": [step.number for step in steps],
            "criterion": [step.criterion for step in steps],
            "lambda": [step.damping for step in steps],
            "accepted": [step.accepted for step in steps],
        }
        thetas = np.array([step.theta for step in steps]).reshape(-1, len(self.names))
        return pd.DataFrame(columns | dict(zip(self.names, thetas.T, strict=True)))

    def rounds_frame(self) -> pd.DataFrame:
        """Return one row a repetition."""
        return pd.DataFrame([dict(each) for each in self.rounds])

    def fit_frames(self) -> tuple[pd.DataFrame, ...]:
        """Return measured and simulated outputs of each experiment."""
        frames = []
        for experiment, simulated in zip(self.experiments, self.simulated, strict=True):
            columns = {"time": experiment.times}
            for k, name in enumerate(experiment.output_names):
                columns[f"measured.{name}"] = experiment.output_values[:, k]
                columns[f"simulated.{name}"] = simulated[:, k]
            frames.append(pd.DataFrame(columns))
        return tuple(frames)
