"""A study: model, experiments, parameters, priors, noise, estimator, and what is asked of the result, from a TOML file.

`fmuid.studies.study_file` has the words of the file.
"""

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
from fmuid.formatting import bounded
from fmuid.identification import Assessment, AssessmentSettings, Problem, assess, identify
from fmuid.models import System
from fmuid.progress import Progress
from fmuid.simulation import OutputFit, Simulator, fit_of
from fmuid.studies.arrays import check_shapes
from fmuid.studies.diagnosis import ParsedDiagnosis
from fmuid.studies.model import ExperimentSettings, ParsedModel, named
from fmuid.studies.overrides import override
from fmuid.studies.parameters import ParameterReader, PriorSource, SourceWarning
from fmuid.studies.section import SectionLocation
from fmuid.studies.settings import MonitoringSection, observed_by
from fmuid.studies.study_file import StudyFile
from fmuid.studies.toml import read_toml

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

    from fmuid.diagnosis import Diagnosis
    from fmuid.studies.batch import BatchSettings


@dataclass(frozen=True)
class Study(HtmlTableMixin):
    """A study file, read and checked; nothing is loaded or simulated before a method asks for it.

    Attributes
    ----------
    path : Path
        The file.
    title : str
        What the file says it is about.
    model : ParsedModel
    experiments : tuple of ExperimentSettings
    parameters : dict of str to Parameter
        The parameters to identify.
    noise : Noise
    estimator : Method
        Marquardt or GlobalSearch.
    loss : str
        How the criterion grows with a residual (`fmuid.data.losses`).
    joint_prior : JointPrior or None
        Beside the priors of single parameters.
    sources : tuple of PriorSource
        The earlier results that priors are taken from.
    uncertainty_settings : AssessmentSettings
        What is asked beyond the local covariance.
    sensitivity : "finite-difference", "forward" or "fmu"
        How the derivatives of the outputs by the parameters are found.
    accuracy : "refine", "report" or "off"
        What is done about the error of the simulation (`fmuid.identify`).
    remedies : bool
        Whether other starts are tried where the search fails or fits badly.
    observer : float or None
        Samples in which an observer forgets that keeps the simulation with the record
        (`fmuid.identification.with_observer`).
    diagnosis : ParsedDiagnosis or None
        The faults to look for, and what is known of the healthy machine.
    monitoring : MonitoringSection
        How records are cut into windows, and what makes an alarm.
    batch : BatchSettings or None
        The many identifications that the study spans.
    data : mapping
        The content of the file, with what was put in place of its values: `Study.of(data, path)` is the same study.

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
    loss: str = "linear"
    joint_prior: JointPrior | None = None
    sources: tuple[PriorSource, ...] = ()
    uncertainty_settings: AssessmentSettings = field(default_factory=AssessmentSettings)
    sensitivity: str = "finite-difference"
    accuracy: str = "refine"
    remedies: bool = True
    observer: float | None = None
    diagnosis: ParsedDiagnosis | None = None
    monitoring: MonitoringSection = field(default_factory=MonitoringSection)
    batch: BatchSettings | None = None
    data: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        tables, names = (", ".join(each) for each in ((given.name for given in self.experiments), self.parameters))
        return bounded(f"Study({self.title!r}: {tables}; {names or 'no parameters'}", 110) + ")"

    @classmethod
    def read(cls, path: str | Path, overrides: Sequence[str] = (), *, isolated: bool = False) -> Study:
        """Read a study file.

        Parameters
        ----------
        path : path-like
            The TOML file. Paths in it are relative to it.
        overrides : sequence of str
            Values to put in place of the file's, each as ``parameters.Rs.start=9`` (`fmuid.studies.overrides`).
        isolated : bool
            Run the FMUs in a process of their own, as ``[isolation]`` says, which costs little and survives an FMU
            that crashes, hangs or takes all memory; default: in this process.

        Raises
        ------
        InputError
            If the file or a file it names is missing, a key is unknown, missing or of the wrong kind, or a prior
            does not fit the parameters.
        """
        path = Path(path)
        data = read_toml(path)
        for setting in overrides:
            override(data, setting, str(path))
        return cls._of(data, path, f"{path} with --set" if overrides else str(path), isolated)

    @classmethod
    def of(cls, data: Mapping[str, Any], path: str | Path, *, isolated: bool = False) -> Study:
        """Return the study that the content of a TOML file is.

        Parameters
        ----------
        data : mapping
            As `tomllib` reads it; copied.
        path, isolated
            As for `read`; the file need not be there.

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
        isolation = words.isolation  # checked also where it is not asked for
        model = replace(words.model.settings(), isolation=isolation if isolated else None)
        experiments = named(words.experiments, top)
        known = ParameterReader(top, model.values).read(
            words.parameters, words.prior, [given.name for given in experiments]
        )
        model = model.choosing(known.choices)
        estimator, search, asked = (
            words.estimation,
            words.estimation.settings(),
            words.uncertainty.settings(known.names),
        )
        own = {given.name: given.noise for given in experiments if given.noise != Noise()}
        noise = replace(words.noise, experiments=own)
        estimator.check_loss(search, asked, top)
        estimator.check_observer({key: getattr(words, key) is not None for key in ("diagnosis", "batch")}, top)
        return cls(
            path,
            words.title,
            model,
            experiments,
            known.parameters,
            noise,
            search,
            estimator.loss,
            known.joint_prior,
            known.sources,
            asked,
            estimator.jacobian,
            estimator.solver_check,
            estimator.restarts,
            estimator.observer_memory,
            None if words.diagnosis is None else words.diagnosis.settings(model, estimator.loss, known),
            words.monitoring,
            None if words.batch is None else words.batch.of(known.parameters, experiments, noise),
            data,
        )

    def files(self) -> tuple[Path, ...]:
        """Return every file that the study refers to, each once: models, tables, results; those of a batch last.

        Raises
        ------
        InputError
            If the data of ``[batch]`` match no file.
        """
        faults, tables = ({}, ()) if self.diagnosis is None else (self.diagnosis.faults, self.diagnosis.tables)
        models = [self.model, *(fault.model for fault in faults.values() if fault.model is not None)]
        found = [path for model in models for path, _ in model.components.values()]
        found += [*(given.data for given in self.experiments), *(each.path for each in self._all_sources), *tables]
        return tuple(dict.fromkeys([*found, *(self.batch.records().values() if self.batch is not None else ())]))

    @property
    def _all_sources(self) -> tuple[PriorSource, ...]:
        healthy = None if self.diagnosis is None else self.diagnosis.source
        return (*self.model.sources, *self.sources, *(() if healthy is None else (healthy,)))

    @cached_property
    def system(self) -> System:
        """The model: its FMUs and their connections.

        Raises
        ------
        InputError
            If an FMU cannot be read, a connection is wrong, or an array has another shape.
        """
        system = self.model.system()
        check_shapes(system, self.data, str(self.path))
        return system

    @cached_property
    def tables(self) -> tuple[Experiment, ...]:
        """The experiments with their tables.

        Raises
        ------
        InputError
            If a table cannot be read or lacks what the study names.
        """
        return tuple(each.read_experiment(each.data) for each in self.experiments)

    def check_parameters(self) -> None:
        """Refuse by an `InputError` a study that names no parameters."""
        if not self.parameters:
            remedy = "name at least one under [parameters], such as R = { start = 4.0 }"
            raise InputError(f"{self.path}: no parameters: {remedy}")

    def problem(self, experiments: Sequence[Experiment] | None = None) -> Problem:
        """Return the least-squares problem of the study.

        Parameters
        ----------
        experiments : sequence of Experiment, optional
            Default: all of them.

        Raises
        ------
        InputError
            If model, tables and parameters do not fit together, there are no parameters, or a prior is taken from a
            result of another model.
        """
        self.check_parameters()
        _ = self.notes  # checks that the results which priors are taken from are of this model
        tables = self.tables if experiments is None else experiments
        problem = Problem(
            self.system,
            tables,
            self.parameters,
            noise=self.noise.among([each.name for each in tables]),
            values=self.model.values,
            joint_prior=self.joint_prior,
            loss=self.loss,
            sensitivity=self.sensitivity,
            choices=self.model.choices,
        )
        return observed_by(problem, self.observer, self.path)

    @cached_property
    def notes(self) -> tuple[SourceWarning, ...]:
        """What is to be known of the results that values and priors are taken from.

        Raises
        ------
        InputError
            If one of them is a result of another model.
        """
        return tuple(dict.fromkeys(note for source in self._all_sources for note in source.compare(self.system)))

    @property
    def known_variance(self) -> dict[str, float]:
        """The noise variance known of each output: the given one, or that of the results that priors are taken from."""
        outputs = tuple(dict.fromkeys(name for given in self.experiments for name in given.outputs))
        found = [each for source in self.sources for each in source.result.noise_variance.items()]
        known = {name: variance for name, variance in found if name in outputs}
        given = self.noise.known(outputs)
        return known | {name: float(value) for name, value in zip(outputs, given, strict=True) if not math.isnan(value)}

    def identify(self, progress: Progress | None = None) -> Result:
        """Identify the parameters, by the method that the study names.

        Parameters
        ----------
        progress : callable, optional
            Called with every step of the search (`fmuid.progress`).

        Raises
        ------
        InputError
            As `problem`, or if a parameter acts on no output, or a global search has no bounds for it.
        SimulationError
            If the simulation at the start fails.
        """
        return self.search(self.problem(), progress)

    def search(self, problem: Problem, progress: Progress | None = None, start: ArrayLike | None = None) -> Result:
        """Search by the method that the study names, and check the simulation as it says (`fmuid.identify`).

        Parameters
        ----------
        problem : Problem
            Of this study.
        progress : callable, optional
        start : (N,) array, optional
            An earlier result, which makes a search of the whole box needless.
        """
        return identify(problem, self.estimator, progress, start, accuracy=self.accuracy, remedies=self.remedies)

    @property
    def fault_search(self) -> ParsedDiagnosis:
        """What ``[diagnosis]`` says; `InputError` where there is none."""
        if self.diagnosis is not None:
            return self.diagnosis
        remedy = 'give it, with baseline = "healthy/result.json" and the fault models as [diagnosis.faults.<name>]'
        raise InputError(f"{self.path} has no [diagnosis]: {remedy}")

    def diagnose(self, progress: Progress | None = None) -> Diagnosis:
        """Look for the faults that ``[diagnosis]`` names.

        Parameters
        ----------
        progress : callable, optional
            Called with a `fmuid.progress.FaultStep` before each fit.

        Raises
        ------
        InputError
            If the study has no ``[diagnosis]``, or models, tables and the healthy result do not fit together.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        from fmuid.diagnosis import diagnose  # and all that decides

        settings = self.fault_search
        faults = settings.fault_models(self.system, self.model, self.data)
        how = settings.how(self.estimator.marquardt, self.sensitivity, self.accuracy)
        try:
            healthy = settings.baseline(self.model, self.parameters, self.noise, self.experiments[0].read_experiment)
            return diagnose(self.tables, healthy, faults, self.system, how, progress)
        except InputError as error:
            raise InputError(f"{settings.where}: {error}") from None

    def assess(self, result: Result, progress: Progress | None = None) -> Assessment:
        """Check a result of this study, with what ``[uncertainty]`` asks for: maps, profiles, posterior.

        Parameters
        ----------
        result : Result
        progress : callable, optional
            Called for every map, point of a profile and step of the sampler (`fmuid.progress`).

        Raises
        ------
        InputError
            If the result is of another study.
        SimulationError
            If the simulation fails at the result.
        """
        return assess(self.problem(), result, self.uncertainty_settings, progress)

    def simulators(self) -> tuple[Simulator, ...]:
        """Return the simulator of each experiment, as a function of the study's parameters in their order."""
        names, values = tuple(self.parameters), self.model.values
        return tuple(Simulator(self.system, table, names, values=values) for table in self.tables)

    def simulate(self) -> list[pd.DataFrame]:
        """Return what `fits` simulates of each experiment: ``time`` (s) and each output, by its name in the FMU."""
        return [fit.simulated_frame() for fit in self.fits()]

    def fits(self) -> tuple[OutputFit, ...]:
        """Simulate every experiment at the parameters' starts and set the measurements beside.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        starts = [each.start for each in self.parameters.values()]
        return tuple(fit_of(self.system, each.experiment, each(starts)) for each in self.simulators())
