"""The words of a study file's tables, and the settings that they give; parameters have `fmuid.studies.parameters`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fmuid.assessment import LEVEL, UncertaintySettings
from fmuid.data import LOSSES, Experiment, Noise
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, Marquardt
from fmuid.files import full, is_file
from fmuid.fmi import KINDS
from fmuid.models import INTEGRATORS, MASTERS, Component, Isolation, Numerics, System
from fmuid.studies import toml as toml
from fmuid.studies.toml import Section
from fmuid.text import nearest

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.assessment import Sampling
    from fmuid.estimation import GlobalSearch

Pairs = tuple[tuple[str, str], ...]

NUMERICS_KEYS = ("interface", "integrator", "tolerance", "step_size")
MODEL_KEYS = ("fmu", *NUMERICS_KEYS, "master", "values", "components", "connections", "connectors")
EXPERIMENT_KEYS = ("table", "name", "time", "inputs", "outputs", "interpolation", "discard", "units")
ISOLATION_KEYS = ("time_limit", "memory", "recycle")
NOISE_KEYS = ("variance", "start")
MARQUARDT_KEYS = ("max_iterations", "tolerance", "first_radius")
GLOBAL_KEYS = ("starts", "search", "seed")
ESTIMATOR_KEYS = ("method", "sensitivity", "loss", *MARQUARDT_KEYS, *GLOBAL_KEYS)
UNCERTAINTY_KEYS = ("level", "profile", "posterior", "map")
POSTERIOR_KEYS = ("walkers", "steps", "burn", "seed")


@dataclass(frozen=True)
class ModelSettings:
    """The table ``[model]``.

    Attributes
    ----------
    components : mapping of str to (Path, Numerics)
        The FMU files and how they are run; a single FMU, or a whole ``.ssp``, is the component ``""``.
    connections : tuple of tuples
        (output, input), both as ``component.variable``, or (output, input, factor, offset).
    numerics : Numerics
        How components run that do not say it themselves.
    master : "jacobi" or "gauss-seidel"
    values : mapping
        The FMU variables held at a value.
    connectors : mapping of str to tuple of str
        Names of the system's own, and the variables that each of them sets.
    isolation : Isolation or None
        How the FMUs run in a process of their own; None: in this one.
    """

    components: Mapping[str, tuple[Path, Numerics]]
    connections: tuple[tuple[str, str] | tuple[str, str, float, float], ...] = ()
    numerics: Numerics = field(default_factory=Numerics)
    master: str = "jacobi"
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    connectors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    isolation: Isolation | None = None

    def system(self) -> System:
        """Return the model: its FMUs and their connections.

        Raises
        ------
        InputError
            If an FMU or SSP cannot be read, or a connection is wrong.
        """
        if "" not in self.components:
            components = {name: Component(path, numerics) for name, (path, numerics) in self.components.items()}
            return System(
                components=components,
                connections=self.connections,
                numerics=self.numerics,
                master=self.master,
                connectors={name: [(each, 1.0, 0.0) for each in some] for name, some in self.connectors.items()},
                isolation=self.isolation,
            )
        path, _ = self.components[""]
        if path.suffix.lower() == ".ssp":
            return System.read_ssp(path, self.numerics, self.master, self.isolation)
        return System(path, numerics=self.numerics, isolation=self.isolation)


@dataclass(frozen=True)
class ExperimentSettings:
    """One entry of ``[[experiments]]``, with the words of `fmuid.Experiment`."""

    table: Path
    name: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    time: str = "time"
    interpolation: str | Mapping[str, str] = "linear"
    discard: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)

    def experiment(self, frame: pd.DataFrame, source: str) -> Experiment:
        """Return the experiment that a table is with these words; messages call the table `source`.

        Raises
        ------
        InputError
            If the table has not what the words say.
        """
        return Experiment(
            frame,
            self.inputs,
            self.outputs,
            time=self.time,
            interpolation=self.interpolation,
            discard=self.discard,
            units=self.units,
            name=self.name,
            source=source,
        )


def read_model(top: Section, folder: Path) -> ModelSettings:
    """Read the table ``[model]``; its paths are relative to `folder`."""
    return model_of(top.table("model", MODEL_KEYS), folder)


def model_of(section: Section, folder: Path) -> ModelSettings:
    """Return the model that a table with the words of ``[model]`` describes."""
    numerics = _read_numerics(section)
    if "fmu" in section.data:
        for key in ("components", "connections", "connectors"):
            if key in section.data:
                raise section.error(f"has both 'fmu' (one FMU) and {key} (of several): keep one of the two")
        components = {"": (existing_file(section, "fmu", "the path of the FMU", folder), numerics)}
    elif "components" in section.data:
        components = _read_components(section, folder)
    else:
        raise section.error("needs the key 'fmu', the path of the FMU, or [[model.components]] where there are several")
    return ModelSettings(
        components,
        tuple(_read_connection(entry) for entry in section.tables("connections", ("from", "to", "factor", "offset"))),
        numerics,
        section.get("master", toml.one_of(*MASTERS), "jacobi"),
        section.get("values", toml.named(toml.scalar), {}),
        section.get("connectors", toml.named(_one_or_more), {}),
    )


def _one_or_more(value: object) -> tuple[str, ...]:
    return (toml.text(value),) if isinstance(value, str) else tuple(toml.names(value))


def _read_numerics(section: Section) -> Numerics:
    return Numerics(
        section.get("interface", toml.one_of(*KINDS), None),
        section.get("integrator", toml.one_of(*INTEGRATORS), None),
        section.get("tolerance", toml.share, None),
        section.get("step_size", toml.positive, None),
    )


def _read_connection(entry: Section) -> tuple[str, str] | tuple[str, str, float, float]:
    source, target = entry.need("from", toml.text, "an output"), entry.need("to", toml.text, "the input that it feeds")
    if not {"factor", "offset"} & set(entry.data):
        return source, target
    return source, target, entry.get("factor", toml.number, 1.0), entry.get("offset", toml.number, 0.0)


def _read_components(section: Section, folder: Path) -> dict[str, tuple[Path, Numerics]]:
    components: dict[str, tuple[Path, Numerics]] = {}
    for entry in section.tables("components", ("name", "fmu", *NUMERICS_KEYS)):
        name = entry.need("name", toml.text, "what its variables are prefixed with")
        if name in components:
            raise entry.error(f"has the name {name!r} of an earlier component: give each its own")
        components[name] = existing_file(entry, "fmu", "the path of the FMU", folder), _read_numerics(entry)
    if not components:
        raise section.error("has no components: name them with [[model.components]]")
    return components


def read_experiments(top: Section, folder: Path) -> tuple[ExperimentSettings, ...]:
    """Read the tables ``[[experiments]]``; their paths are relative to `folder`."""
    found: list[ExperimentSettings] = []
    for entry in top.tables("experiments", EXPERIMENT_KEYS):
        table = existing_file(entry, "table", "the file of measurements", folder)
        name = entry.get("name", toml.text, table.stem)
        if name in (earlier.name for earlier in found):
            raise entry.error(f'is called {name!r} like an earlier one: give it a name of its own, name = "..."')
        found.append(
            ExperimentSettings(
                table,
                name,
                entry.get("inputs", toml.columns, {}),
                entry.need("outputs", toml.columns, "the measured outputs, a list of names"),
                entry.get("time", toml.text, "time"),
                entry.get("interpolation", _interpolation, _interpolation("linear")),
                entry.get("discard", toml.not_negative, 0.0),
                entry.get("units", toml.named(toml.text), {}),
            )
        )
        if not found[-1].outputs:
            raise entry.error('has no outputs: name those that are measured, outputs = ["..."]')
    if not found:
        raise top.error("has no experiments: name at least one table with [[experiments]]")
    return tuple(found)


def _interpolation(value: object) -> str | Mapping[str, str]:
    kind = toml.one_of("linear", "hold", "cubic")
    return toml.named(kind)(value) if isinstance(value, dict) else kind(value)


def read_isolation(top: Section) -> Isolation:
    """Read the table ``[isolation]``: what FMUs in a process of their own may do."""
    section = top.table("isolation", ISOLATION_KEYS)
    return Isolation(
        section.get("time_limit", toml.positive, None),
        section.get("memory", toml.positive, None),
        section.get("recycle", toml.count, None),
    )


def read_noise(top: Section) -> Noise:
    """Read the table ``[noise]``."""
    section = top.table("noise", NOISE_KEYS)
    return Noise(section.get("variance", _variance, "estimate"), section.get("start", _variances, None))


def _variances(value: object) -> float | Mapping[str, float]:
    return toml.named(toml.positive)(value) if isinstance(value, dict) else toml.positive(value)


def _variance(value: object) -> Literal["estimate"] | float | Mapping[str, float]:
    if value == "estimate":
        return "estimate"
    if isinstance(value, str):
        raise toml.MismatchError('"estimate", a number above 0 or a table { output = number }')
    return _variances(value)


def read_estimator(top: Section) -> Marquardt | GlobalSearch:
    """Read the table ``[estimator]``: Marquardt's search, or a search of the whole box that ends in it.

    Who gives ``starts`` wants a search from each of them, and need not say that the method is global and the search
    "multistart".
    """
    section = top.table("estimator", ESTIMATOR_KEYS)
    implied = "global" if {"starts", "search"} & set(section.data) else "marquardt"
    method = section.get("method", toml.one_of("marquardt", "global", later=("linear",)), implied)
    default = Marquardt()
    marquardt = Marquardt(
        section.get("max_iterations", toml.count, default.max_iterations),
        section.get("tolerance", toml.positive, default.tolerance),
        section.get("first_radius", toml.positive, default.first_radius),
    )
    if method == "marquardt":
        for key in GLOBAL_KEYS:
            if key in section.data:
                raise section.error(f'has {key}, which goes with method = "global": choose that, or remove {key}')
        return marquardt
    from fmuid.estimation import GlobalSearch

    words: dict[str, Any] = {
        "method": section.get(
            "search", toml.one_of("multistart", "evolution"), "multistart" if "starts" in section.data else "evolution"
        ),
        "seed": section.get("seed", toml.natural, 0),
    }
    if "starts" in section.data:
        words["starts"] = section.get("starts", toml.count, 1)
    try:
        return GlobalSearch(**words, marquardt=marquardt)
    except InputError as error:
        raise section.error(f"is refused: {error}") from None


def read_sensitivity(top: Section) -> str:
    """Read the word ``sensitivity`` of the table ``[estimator]``."""
    return top.table("estimator", ESTIMATOR_KEYS).get("sensitivity", toml.one_of(*SENSITIVITIES), "finite-difference")


def read_loss(top: Section, estimator: Marquardt | GlobalSearch, asked: UncertaintySettings) -> str:
    """Read the word ``loss`` of the table ``[estimator]``, and check that all the rest knows what to do with it."""
    loss = top.table("estimator", ESTIMATOR_KEYS).get("loss", toml.one_of(*LOSSES), "linear")
    for other, there in (('method = "global"', not isinstance(estimator, Marquardt)), ("map", bool(asked.maps))):
        if there and loss != "linear":
            raise top.error(
                f'has both loss = "{loss}" and {other}, which compares plain sums of squares in this version: '
                "keep one of the two"
            )
    return loss


def read_uncertainty(top: Section, names: Sequence[str]) -> UncertaintySettings:
    """Read the table ``[uncertainty]`` of a study with these parameters."""
    section = top.table("uncertainty", UNCERTAINTY_KEYS)
    profile: bool | list[str] = section.get("profile", _names_or_all, False)
    chosen = tuple(dict.fromkeys(profile)) if isinstance(profile, list) else tuple(names) if profile else ()
    pairs: Pairs = section.get("map", _pairs, ())
    for key, given in (("profile", chosen), ("map", [name for pair in pairs for name in pair])):
        for name in given:
            if name not in names:
                raise section.error(f"{key} names {name!r}, which is no parameter of this study{nearest(name, names)}")
    return UncertaintySettings(section.get("level", toml.share, LEVEL), chosen, _read_posterior(section), pairs)


def _read_posterior(section: Section) -> Sampling | None:
    given = section.data.get("posterior", False)
    if isinstance(given, bool) and not given:
        return None
    from fmuid.assessment import Sampling

    if given is True:
        return Sampling()
    table = section.table("posterior", POSTERIOR_KEYS)
    kinds = {"walkers": toml.count, "steps": toml.count, "burn": toml.not_negative, "seed": toml.natural}
    words: dict[str, Any] = {key: table.get(key, kind, None) for key, kind in kinds.items() if key in table.data}
    try:
        return Sampling(**words)
    except InputError as error:
        raise table.error(f"is refused: {error}") from None


def _names_or_all(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    if isinstance(value, list) and all(isinstance(item, str) and item for item in value):
        return list(value)
    raise toml.MismatchError('true (all parameters), false or a list of parameters, ["Rs", "Rr"]')


def _pairs(value: object) -> Pairs:
    def is_pair(item: object) -> bool:
        return isinstance(item, list) and len(item) == 2 and all(isinstance(name, str) and name for name in item)

    if is_pair(value):
        value = [value]
    if not isinstance(value, list) or not all(is_pair(item) for item in value):
        raise toml.MismatchError('a list of pairs of parameters, [["Rs", "Lf"]]')
    for first, second in value:
        if first == second:
            raise toml.MismatchError(f"a list of pairs of two different parameters ({first!r} is there with itself)")
    return tuple((first, second) for first, second in value)


def existing_file(section: Section, key: str, meaning: str, folder: Path) -> Path:
    """Return the path of a file that must be there."""
    path = folder / section.need(key, toml.text, meaning)
    if not is_file(path):
        raise section.error(f"{key} = {toml.show(section.data[key])}: there is no file {full(path)}")
    return path
