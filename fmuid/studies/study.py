"""Studies: TOML files as objects."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid.data import Experiment, JointPrior, Noise, Parameter
from fmuid.display_mixins import HtmlTableMixin
from fmuid.errors import InputError
from fmuid.estimation import Method, Result
from fmuid.events import Progress
from fmuid.formatting import bounded
from fmuid.identification import Assessment, AssessmentSettings, Problem, assess, identify, with_quantities
from fmuid.models import System
from fmuid.simulation import AnySimulator, OutputFit, Value, fit_of, simulator_of
from fmuid.studies.array_elements import check_shapes
from fmuid.studies.estimation import EstimationSection, MonitoringSection
from fmuid.studies.faults import DiagnosisSection
from fmuid.studies.model import ExperimentSettings, ParsedModel, named
from fmuid.studies.nameplate import prior_by_nameplate
from fmuid.studies.parameters import ParameterReader, PriorSource, SourceWarning, conditional_prior
from fmuid.studies.section import SectionLocation
from fmuid.studies.study_file import StudyFile, override
from fmuid.studies.toml import read_toml

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

    from fmuid.diagnosis import Diagnosis
    from fmuid.studies.batch import BatchSettings


@dataclass(frozen=True)
class Study(HtmlTableMixin):
    """Study file, read and checked; FMUs and data are loaded on use.

    Attributes
    ----------
    path : Path
        File.
    title : str
        Title.
    model : ParsedModel
        FMUs and their connections.
    experiments : tuple of ExperimentSettings
        Experiments.
    parameters : dict of str to Parameter
        Parameters to identify.
    noise : Noise
        Measurement noise.
    estimator : Method
        Marquardt or GlobalSearch.
    joint_prior : JointPrior or None
        Prior of several parameters.
    sources : tuple of PriorSource
        Results that priors are taken from.
    uncertainty_settings : AssessmentSettings
        Checks beyond the local covariance.
    estimation : EstimationSection
        Loss, Jacobian, solver check, restarts, observer.
    diagnosis : DiagnosisSection or None
        Faults and baseline.
    monitoring : MonitoringSection
        Windows and alarms.
    batch : BatchSettings or None
        Cases.
    data : mapping
        Content of the file; `Study.of(data, path)` is the same study.

    Examples
    --------
    >>> study = fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml")
    >>> study.identify()["R"].unit
    'Ohm'
    """

    path: Path
    title: str
    model: ParsedModel
    experiments: tuple[ExperimentSettings, ...]
    parameters: Mapping[str, Parameter]
    noise: Noise
    estimator: Method
    joint_prior: JointPrior | None
    sources: tuple[PriorSource, ...]
    uncertainty_settings: AssessmentSettings
    estimation: EstimationSection
    diagnosis: DiagnosisSection | None
    monitoring: MonitoringSection
    batch: BatchSettings | None
    data: Mapping[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        tables, names = (", ".join(each) for each in ((given.name for given in self.experiments), self.parameters))
        return bounded(f"Study({self.title!r}: {tables}; {names or 'no parameters'}", 110) + ")"

    @classmethod
    def read(cls, path: str | Path, overrides: Sequence[str] = (), *, isolated: bool = False) -> Study:
        """Read a study file.

        Parameters
        ----------
        path : path-like
            TOML file; paths in it are relative to it.
        overrides : sequence of str
            Values to set, each as ``parameters.Rs.start=9`` (`fmuid.studies.study_file`).
        isolated : bool
            Run FMUs in separate processes, as ``[isolation]`` says.

        Raises
        ------
        InputError
            If a file is missing, a key or value is wrong, or a prior does not fit.
        """
        path = Path(path)
        data = read_toml(path)
        for setting in overrides:
            override(data, setting, str(path))
        return cls._of(data, path, f"{path} with --set" if overrides else str(path), isolated)

    @classmethod
    def of(cls, data: Mapping[str, Any], path: str | Path, *, isolated: bool = False) -> Study:
        """Return the study of a TOML file's content.

        Parameters
        ----------
        data : mapping
            As `tomllib` reads it; copied.
        path, isolated
            As for `read`; the file may be missing.

        Raises
        ------
        InputError
            As `read`.
        """
        return cls._of(copy.deepcopy(dict(data)), Path(path), str(path), isolated)

    @classmethod
    def _of(cls, data: dict[str, Any], path: Path, file: str, isolated: bool) -> Study:
        top = SectionLocation(file, path.parent)
        words = StudyFile.read(data, top)
        model = replace(words.model.settings(), isolation=words.isolation if isolated else None)
        experiments = named(words.experiments, top)
        prior = None if isinstance(words.prior, str) else words.prior
        known = ParameterReader(top, model.values).read(words.parameters, prior, [given.name for given in experiments])
        by_plate = prior_by_nameplate(words.prior, words.nameplate, model, known.names, top)
        with top.below("parameters").located():
            parameters = with_quantities([each.observed for each in experiments], known.parameters)
        model = model.choosing(known.choices)
        estimation, search = words.estimation, words.estimation.settings()
        asked = words.uncertainty.settings(known.names)
        own = {each.name: each.noise for each in experiments if each.noise != Noise()}
        noise = replace(words.noise, experiments=own)
        estimation.check_loss(search, asked, top)
        estimation.check_observer({key: getattr(words, key) is not None for key in ("diagnosis", "batch")}, top)
        return cls(
            path,
            words.title,
            model,
            experiments,
            parameters,
            noise,
            search,
            by_plate or known.joint_prior,
            known.sources,
            asked,
            estimation,
            None if words.diagnosis is None else words.diagnosis.of(model, estimation.loss, known),
            words.monitoring,
            None if words.batch is None else words.batch.of(parameters, experiments, noise),
            data,
        )

    def files(self) -> tuple[Path, ...]:
        """Return each file of the study once; those of a batch last.

        Raises
        ------
        InputError
            If the data of ``[batch]`` match no file.
        """
        faults, tables = ({}, ()) if self.diagnosis is None else (self.diagnosis.faults, self.diagnosis.tables)
        models = [self.model, *(own for fault in faults.values() if (own := fault.own_model) is not None)]
        found = [path for model in models for path, _ in model.components.values()]
        found += [*(given.data for given in self.experiments), *(each.path for each in self._all_sources), *tables]
        return tuple(dict.fromkeys([*found, *(self.batch.records().values() if self.batch is not None else ())]))

    @property
    def _all_sources(self) -> tuple[PriorSource, ...]:
        healthy = None if self.diagnosis is None else self.diagnosis.source
        return (*self.model.sources, *self.sources, *(() if healthy is None else (healthy,)))

    @cached_property
    def system(self) -> System:
        """FMUs and their connections.

        Raises
        ------
        InputError
            If an FMU is unreadable, a connection wrong, or an array of another shape.
        """
        system = self.model.system()
        check_shapes(system, self.data, str(self.path))
        return system

    @cached_property
    def tables(self) -> tuple[Experiment, ...]:
        """Experiments with their data.

        Raises
        ------
        InputError
            If a data file is unreadable or lacks a column.
        """
        return tuple(each.read_experiment(each.data) for each in self.experiments)

    def check_parameters(self) -> None:
        """Refuse by an `InputError` a study that names no parameters."""
        if not self.parameters:
            raise InputError(f"{self.path}: parameters: no free parameter. Add one, such as R = {{ start = 4.0 }}.")

    @cached_property
    def flat_names(self) -> dict[str, str]:
        """All parameters with their variables, those per experiment one by one."""
        names = [each.name for each in self.experiments]
        return {each.name_in(given, name): name for name, each in self.parameters.items() for given in names}

    def free_parameters(self, held: Mapping[str, Value], starts: Mapping[str, float]) -> dict[str, Parameter]:
        """Return the parameters that are not held, some with other initial guesses."""
        free = {name: each for name, each in self.parameters.items() if name not in held}
        return {name: replace(each, start=starts[name]) if name in starts else each for name, each in free.items()}

    def problem(
        self,
        experiments: Sequence[Experiment] | None = None,
        held: Mapping[str, Value] | None = None,
        starts: Mapping[str, float] | None = None,
    ) -> Problem:
        """Return the least-squares problem of the study.

        Parameters
        ----------
        experiments : sequence of Experiment, optional
            Default: all of them.
        held : mapping of str to value, optional
            Further fixed variables; parameters among them are not free.
        starts : mapping of str to float, optional
            Other initial guesses.

        Raises
        ------
        InputError
            If model, data, parameters and priors do not fit together.
        """
        self.check_parameters()
        _ = self.notes  # refuses results of another model
        tables, held, prior = self.tables if experiments is None else experiments, held or {}, self.joint_prior
        if prior is not None and held:
            known = {flat: float(held[name]) for flat, name in self.flat_names.items() if name in held}
            prior = conditional_prior(prior, known)
        problem = Problem(
            self.system,
            tables,
            self.free_parameters(held, starts or {}),
            noise=self.noise.among([each.name for each in tables]),
            values={**self.model.values, **held},
            joint_prior=prior,
            loss=self.estimation.loss,
            sensitivity=self.estimation.jacobian,
            choices={name: few for name, few in self.model.choices.items() if name not in held},
        )
        return self.estimation.observed(problem)

    @cached_property
    def notes(self) -> tuple[SourceWarning, ...]:
        """Issues of results that values and priors are taken from.

        Raises
        ------
        InputError
            If one is of another model.
        """
        return tuple(dict.fromkeys(note for source in self._all_sources for note in source.compare(self.system)))

    @property
    def known_variance(self) -> dict[str, float]:
        """Known noise variance of each output: given, or that of prior results."""
        outputs = tuple(dict.fromkeys(name for given in self.experiments for name in given.output_names))
        found = [each for source in self.sources for each in source.result.fit.noise_variance.items()]
        known = {name: variance for name, variance in found if name in outputs}
        given = self.noise.known(outputs)
        return known | {name: float(value) for name, value in zip(outputs, given, strict=True) if not math.isnan(value)}

    def identify(self, progress: Progress | None = None) -> Result:
        """Identify the parameters by the study's method.

        Parameters
        ----------
        progress : callable, optional
            Called with every step (`fmuid.events`).

        Raises
        ------
        InputError
            As `problem`, or if a parameter has no effect, or no bounds for a global search.
        SimulationError
            If the simulation at the initial guess fails.
        """
        return self.search(self.problem(), progress)

    def search(self, problem: Problem, progress: Progress | None = None, start: ArrayLike | None = None) -> Result:
        """Optimize by the study's method, with its solver check (`fmuid.identify`).

        Parameters
        ----------
        problem : Problem
            Of this study.
        progress : callable, optional
            As for `identify`.
        start : (N,) array, optional
            Earlier result, in place of a global search.
        """
        check, restarts = self.estimation.solver_check, self.estimation.restarts
        return identify(problem, self.estimator, progress, start, solver_check=check, restart=restarts)

    @property
    def fault_search(self) -> DiagnosisSection:
        """Table ``[diagnosis]``; `InputError` without one."""
        if self.diagnosis is not None:
            return self.diagnosis
        raise InputError(f"{self.path}: no [diagnosis]. Add it with baseline and [diagnosis.faults.<name>].")

    def diagnose(self, progress: Progress | None = None) -> Diagnosis:
        """Search for the faults of ``[diagnosis]``.

        Parameters
        ----------
        progress : callable, optional
            Called with a `fmuid.events.FaultStep` before each fit.

        Raises
        ------
        InputError
            If there is no ``[diagnosis]``, or models, data and baseline do not fit together.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        from fmuid.diagnosis import DiagnosisSettings, diagnose

        settings = self.fault_search
        faults = settings.fault_models(self.system, self.model, self.data)
        how = DiagnosisSettings(
            settings.false_alarm_rate,
            self.estimator.marquardt,
            self.estimation.jacobian,
            self.estimation.solver_check,
            settings.causes,
            settings.fault_model_error,
        )
        with settings.place.located():
            healthy = settings.healthy(self.model, self.parameters, self.noise, self.experiments[0].read_experiment)
            return diagnose(self.tables, healthy, faults, self.system, how, progress)

    def assess(self, result: Result, progress: Progress | None = None) -> Assessment:
        """Check a result, as ``[uncertainty]`` says.

        Parameters
        ----------
        result : Result
            Of this study.
        progress : callable, optional
            Called for every map, point of a profile and step of the sampler.

        Raises
        ------
        InputError
            If the result is of another study.
        SimulationError
            If the simulation fails at the result.
        """
        return assess(self.problem(), result, self.uncertainty_settings, progress)

    def simulators(self) -> tuple[AnySimulator, ...]:
        """Return the simulator of each experiment, a function of the parameters."""
        names, values = tuple(self.parameters), self.model.values
        return tuple(simulator_of(self.system, table, names, values) for table in self.tables)

    def simulate(self) -> list[pd.DataFrame]:
        """Return frames of ``time`` (s) and simulated outputs, one per experiment."""
        return [fit.simulated_frame() for fit in self.fits()]

    def fits(self) -> tuple[OutputFit, ...]:
        """Simulate every experiment at the initial guess, and compare with the data.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        starts = [each.start for each in self.parameters.values()]
        return tuple(fit_of(self.system, each.experiment, each(starts)) for each in self.simulators())
