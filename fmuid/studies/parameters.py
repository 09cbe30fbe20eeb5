"""The tables ``[parameters]`` and ``[prior]`` of a study file, and the earlier results that they take priors from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmuid.data import JointPrior, Normal, Parameter, ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.models import System
from fmuid.studies import toml as toml
from fmuid.studies.settings import existing_file
from fmuid.studies.toml import Section
from fmuid.text import nearest

PARAMETER_KEYS = ("start", "min", "max", "nominal", "prior", "per_experiment")
GIVEN_KEYS, RESULT_KEYS = ("mean", "std"), ("result", "inflate")
JOINT_KEYS = ("names", "mean", "covariance", *RESULT_KEYS)


@dataclass(frozen=True, eq=False)
class Source:
    """An earlier result from which a study takes priors.

    Attributes
    ----------
    where : str
        The study file and the table that names it, for messages.
    path : Path
        The ``result.json``.
    result : Result
    names : tuple of str
        The parameters taken from it.
    """

    where: str
    path: Path
    result: Result
    names: tuple[str, ...]

    def compare(self, system: System) -> list[str]:
        """Compare the models that the parameters belong to with those of a study.

        Returns
        -------
        list of str
            What differs without being wrong, in words.

        Raises
        ------
        InputError
            If the result is one of another model.
        """
        notes = []
        if not self.result.converged:
            notes.append(f"{self.path}, which priors are taken from, did not succeed: {self.result.status}")
        if not self.result.models:
            return [*notes, f"{self.path} does not say of which model it is a result"]
        for component in dict.fromkeys(system.split(name)[0] for name in self.names):
            fmu = system.components[component].fmu
            earlier = self.result.models.get(component)
            if earlier is None or earlier["name"] != fmu.name:
                theirs = ", ".join(model["name"] for model in self.result.models.values())
                as_ = f" as {component!r}" if component else ""
                raise InputError(
                    f"{self.where}: {self.path} is a result of another model, {theirs}, and this study has "
                    f"{fmu.name}{as_}: give the result of an identification of {fmu.name}"
                )
            if earlier["digest"] != fmu.digest:
                notes.append(f"{self.path} was made with another build of {fmu.name} than {fmu.path}")
        return notes


@dataclass(frozen=True, eq=False)
class Knowns:
    """What a study says of its parameters.

    Attributes
    ----------
    parameters : dict of str to Parameter
    joint_prior : JointPrior or None
    sources : tuple of Source
    names : tuple of str
        All parameters, those per experiment one by one.
    """

    parameters: dict[str, Parameter]
    joint_prior: JointPrior | None
    sources: tuple[Source, ...]
    names: tuple[str, ...]


def read_parameters(
    top: Section, folder: Path, experiments: Sequence[str], held: Mapping[str, float | int | bool | str]
) -> Knowns:
    """Read the tables ``[parameters]`` and ``[prior]``.

    Parameters
    ----------
    top : Section
        The study file.
    folder : Path
        Results are named relative to it.
    experiments : sequence of str
        Names of the experiments.
    held : mapping
        The variables held at a value.

    Raises
    ------
    InputError
        If a key is unknown, missing or of the wrong kind, or a prior does not fit its parameter.
    """
    return _Reader(top, folder, held).read(experiments)


class _Reader:
    """Reads the parameters and their priors, each result file once."""

    def __init__(self, top: Section, folder: Path, held: Mapping[str, float | int | bool | str]) -> None:
        self.top, self.folder, self.held = top, folder, held
        self.results: dict[Path, Result] = {}
        self.sources: list[Source] = []

    def read(self, experiments: Sequence[str]) -> Knowns:
        listed = list(self.top.table("parameters", self.top.data.get("parameters", {})).data)
        section = self.top.table("parameters", listed)
        parameters = {name: self._parameter(name, section.table(name, PARAMETER_KEYS)) for name in listed}
        if not parameters:
            if "prior" in self.top.data:
                raise self.top.error("has a [prior] and no parameters: name those to identify under [parameters]")
            return Knowns({}, None, (), ())
        alone = self._set(parameters, experiments, None, "[parameters]")
        if "prior" not in self.top.data:
            return Knowns(parameters, None, tuple(self.sources), alone.names)
        joint = self._joint(self.top.table("prior", JOINT_KEYS), alone.names)
        self._set(parameters, experiments, joint, "[prior]")
        return Knowns(parameters, joint, tuple(self.sources), alone.names)

    def _set(
        self, parameters: Mapping[str, Parameter], experiments: Sequence[str], joint: JointPrior | None, where: str
    ) -> ParameterSet:
        try:
            return ParameterSet(parameters, experiments, joint)
        except InputError as error:
            raise InputError(f"{self.top.file}: {where}: {error}") from None

    def _parameter(self, name: str, section: Section) -> Parameter:
        words: dict[str, Any] = {
            "start": section.need("start", toml.number, "where the search begins"),
            "min": section.get("min", toml.number, -math.inf),
            "max": section.get("max", toml.number, math.inf),
            "nominal": section.get("nominal", toml.positive, None),
            "per_experiment": section.get("per_experiment", toml.flag, False),
        }
        prior = self._normal(name, section) if "prior" in section.data else None
        try:
            return Parameter(**words, prior=prior)
        except InputError as error:  # a Parameter does not know what it is called
            raise InputError(f"{section.file}: {section.where}: {error}") from None

    def _normal(self, name: str, section: Section) -> Normal:
        table = section.table("prior", (*GIVEN_KEYS, *RESULT_KEYS))
        if not self._from_result(table, GIVEN_KEYS):
            return Normal(
                table.need("mean", toml.number, "its mean"), table.need("std", toml.positive, "its standard deviation")
            )
        path, result = self._result(table)
        self._known(table, path, result, [name])
        try:
            normal = result.normal(name, inflate=table.get("inflate", toml.positive, 1.0))
        except InputError as error:
            raise InputError(f"{table.file}: {table.where}: {path}: {error}") from None
        self.sources.append(Source(f"{table.file}: {table.where}", path, result, (name,)))
        return normal

    def _joint(self, table: Section, names: Sequence[str]) -> JointPrior:
        chosen = table.get("names", toml.names, None)
        for name in chosen or ():
            if name in self.held:
                raise table.error(
                    f"names {name!r}, which [model.values] holds at {toml.show(self.held[name])}: a prior is for "
                    "parameters to identify, so move it to [parameters] or leave it out here"
                )
            if name not in names:
                raise table.error(f"names {name!r}, which is no parameter of this study{nearest(name, names)}")
        try:
            if self._from_result(table, ("mean", "covariance")):
                return self._joint_from_result(table, chosen, names)
            return self._joint_given(table, table.need("names", toml.names, "the parameters that it is about"))
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(table.file) else f"{table.file}: {table.where}: {said}") from None

    def _joint_given(self, table: Section, names: Sequence[str]) -> JointPrior:
        mean = table.need("mean", toml.numbers, "the means of the parameters that it names")
        covariance = table.need("covariance", toml.matrix, "the covariance of the parameters that it names, row by row")
        return JointPrior(names, mean, covariance)

    def _joint_from_result(self, table: Section, chosen: Sequence[str] | None, names: Sequence[str]) -> JointPrior:
        path, result = self._result(table)
        shared = [name for name in names if name in result.names] if chosen is None else list(chosen)
        if not shared:
            raise table.error(
                f"takes nothing from {path}: it has {', '.join(result.names)}, and this study {', '.join(names)}; "
                "give the result of an identification of the same model"
            )
        self._known(table, path, result, shared)
        self.sources.append(Source(f"{table.file}: {table.where}", path, result, tuple(shared)))
        try:
            return result.prior(shared, inflate=table.get("inflate", toml.positive, 1.0))
        except InputError as error:
            raise table.error(f"cannot be taken from {path}: {error}") from None

    def _from_result(self, table: Section, given: Sequence[str]) -> bool:
        """Whether a prior comes from a result, and not from numbers in the study."""
        if "result" not in table.data:
            if "inflate" in table.data:
                raise table.error("has inflate, which goes with result: name the result.json, or remove it")
            return False
        for key in given:
            if key in table.data:
                raise table.error(f"has both result and {key}: keep one of the two")
        return True

    def _result(self, table: Section) -> tuple[Path, Result]:
        path = existing_file(table, "result", "the result.json of an earlier identification", self.folder)
        try:
            return path, self.results.setdefault(path, self.results.get(path) or Result.from_json(path))
        except InputError as error:
            raise InputError(f"{table.file}: {table.where}: {error}") from None

    def _known(self, table: Section, path: Path, result: Result, names: Sequence[str]) -> None:
        for name in names:
            if name not in result.names:
                raise table.error(
                    f"takes {name!r} from {path}, which has no such parameter{nearest(name, result.names)}; "
                    f"it has {', '.join(result.names)}"
                )
