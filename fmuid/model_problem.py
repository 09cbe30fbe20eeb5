"""The problem of an identification whose predictors run FMUs: where models and estimation meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmuid.data import Experiment, JointPrior, Noise, Parameter
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, LeastSquares
from fmuid.fmi import FMU
from fmuid.models import System
from fmuid.simulation import Simulator, derivatives_of
from fmuid.text import nearest


class Problem(LeastSquares):
    """A model, experiments and parameters: everything that the estimators need, as functions of theta.

    Parameters
    ----------
    model : System, FMU or path
    experiments : Experiment or sequence of Experiment
    parameters : mapping of str to Parameter
        By FMU variable.
    noise : Noise
    values : mapping of str to float, int, bool or str, optional
        FMU variables held at a value.
    step_size : float, optional
        Largest step of the simulation, s.
    joint_prior : JointPrior, optional
        Beside the priors of single parameters.
    loss : "linear", "soft_l1", "huber" or "cauchy"
        How the criterion grows with a sample's residual in standard deviations of the noise: all but "linear", the
        plain square, keep outliers from pulling (`fmuid.data.losses`). Priors always count by their squares.
    sensitivity : "finite-difference", "forward" or "fmu"
        How the derivatives of the outputs by the parameters are found
        (`fmuid.estimation.model_derivatives.SENSITIVITIES`).

    Raises
    ------
    InputError
        If there are no experiments, parameters, outputs or counted samples, too few for the parameters, or if there is
        no such loss or sensitivity.
    """

    def __init__(
        self,
        model: System | FMU | str | Path,
        experiments: Experiment | Sequence[Experiment],
        parameters: Mapping[str, Parameter],
        *,
        noise: Noise | None = None,
        values: Mapping[str, float | int | bool | str] | None = None,
        step_size: float | None = None,
        joint_prior: JointPrior | None = None,
        loss: str = "linear",
        sensitivity: str = "finite-difference",
    ) -> None:
        if sensitivity not in SENSITIVITIES:
            near = nearest(sensitivity, SENSITIVITIES)
            raise InputError(f"sensitivity {sensitivity!r} is not known{near}: give {' or '.join(SENSITIVITIES)}")
        self.system = System.of(model)
        listed = [experiments] if isinstance(experiments, Experiment) else list(experiments)
        simulators = self._simulators = [
            Simulator(self.system, experiment, tuple(parameters), values=values or {}, step_size=step_size)
            for experiment in listed
        ]
        by_model = (
            [] if sensitivity == "finite-difference" else [derivatives_of(each, sensitivity) for each in simulators]
        )
        super().__init__(
            simulators,
            listed,
            parameters,
            noise=noise,
            joint_prior=joint_prior,
            loss=loss,
            sensitivity=sensitivity,
            derivatives=by_model,
        )

    @property
    def models(self) -> dict[str, dict[str, str]]:
        """``name``, ``digest`` and ``run`` (how it is run, in words) of each FMU by its component."""
        stiff = frozenset[str]().union(*(each.stiff for each in self._simulators))
        return {
            name: {"name": model.fmu.name, "digest": model.fmu.digest, "run": model.words(stiff=name in stiff)}
            for name, model in self.system.components.items()
        }
