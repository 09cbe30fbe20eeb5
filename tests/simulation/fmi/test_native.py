"""The core in C: how it is built and loaded, what Python refuses before it sees it, what only it does."""

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from fmuid import FMU, InputError, Numerics, SimulationError, Simulator, System, __version__
from fmuid.simulation import codes
from fmuid.simulation.instance import Instance
from fmuid.simulation.native import build, library
from fmuid.simulation.plan_builder import simulation_of
from fmuid.simulation.simulation_loop import SimulationLoop
from fmuid.simulation.simulation_plan import GridSimulation, Operation, check_arrays, check_plan, new_reports
from fmuid.simulation.simulation_task import task_of
from tests.support.compiled import ProbeMaker
from tests.support.experiments import record
from tests.support.exported import export_text
from tests.support.paths import FMUS
from tests.support.sanitizers import SANITIZE, assert_nothing_found, needs_sanitizers

Array = NDArray[np.float64]
TIMES: Array = np.linspace(0.0, 1.0, 5)


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The sources of the core in a folder of their own."""
    folder = tmp_path / "native"
    shutil.copytree(build.HERE, folder, ignore=shutil.ignore_patterns("core-*", "__pycache__"))
    monkeypatch.setattr(build, "HERE", folder)
    return folder


# --- built and loaded


def test_it_compiles_without_a_warning(tmp_path: Path) -> None:
    tag = build.tag_here()
    target = build.TARGETS[tag][0] if tag else None
    assert build.build(tmp_path / "core.so", target, (*build.FLAGS, *build.WARNINGS)).is_file()


@pytest.mark.slow
def test_changed_sources_are_compiled_anew(copied: Path) -> None:
    first = library._path()
    assert library._path() == first
    with (copied / "log.c").open("a") as source:
        source.write("/* changed */\n")
    second = library._path()
    assert second != first
    assert [path.name for path in copied.glob("core-*")] == [second.name]


def test_without_a_compiler_it_is_one_sentence(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(InputError, match=r"core must be compiled. No C compiler found"):
        library._path()
    monkeypatch.setenv("CC", f"{sys.executable} -c 'raise SystemExit(3)'")
    with pytest.raises(InputError, match=r" fails: "):
        library._path()
    assert not list(copied.glob("core-*"))
    monkeypatch.setattr(build, "HERE", copied.parent)
    with pytest.raises(InputError, match=r"fmuid's compiled core is missing"):
        library._path()


def test_a_library_of_other_sources_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    core = library.core()
    assert library._difference(core) == ""
    with monkeypatch.context() as patch:
        patch.setattr(library, "__version__", "0.0.9")
        assert library._difference(core) == __version__
    monkeypatch.setattr(codes, "DO_STEP", codes.RESET)
    assert library._difference(core) == "DO_STEP"
    monkeypatch.undo()
    monkeypatch.setattr(codes, "PROCESS", codes.PROCESS + 1)
    assert library._difference(core) == "CANCELLED"


@pytest.mark.parametrize(("field", "place"), [("offset", 8), ("size", 4)])
def test_a_layout_that_ctypes_does_not_know_is_refused(field: str, place: int) -> None:
    class Library:
        def layout(self) -> Any:
            told = (library._FieldLayout * 3)(
                library._FieldLayout(b"Made", b"n", b"c_double", 0, 8), library._FieldLayout(b"Made", size=8)
            )
            setattr(told[0 if field == "offset" else 1], field, place)
            return told

    with pytest.raises(InputError, match="another layout of Made"):
        library._structures(Library())


def test_every_compiler_is_told_its_target() -> None:
    """Without one it takes the instructions of the machine that builds: other digits, and none on older machines."""
    root = Path(__file__).parents[2]
    for path in (*root.glob("tests/**/*.py"), *root.glob("experiments/**/*.py"), *root.glob("fmuid/**/*.py")):
        if path != Path(__file__):
            said = path.read_text(encoding="utf-8")
            assert '"ziglang", "cc"' not in said or '"cc", "-target"' in said, path


# --- what Python refuses


Planned = tuple[GridSimulation, list[int]]


@pytest.fixture(scope="module")
def runs() -> dict[str, Planned]:
    """Plans of all kinds with the versions of their components: connected, with a loop, by model exchange."""
    u = np.sin(TIMES)
    coil = FMUS / "Coil" / "Coil.fmu"
    pair = System(components={"a": coil, "b": coil}, connections=[("a.i", "b.u", 2.0, 1.0)], master="gauss-seidel")
    single, exchanged = record(TIMES, {"u": u}, ["i"], "linear"), System(coil, numerics=Numerics("model-exchange"))
    tasks = {
        "pair": task_of(pair, record(TIMES, {"a.u": u}, ["b.i"], "linear"), ["a.R"], {}, None),
        "co-simulation": task_of(System(coil), single, ["R", "L"], {}, 0.01),
        "model exchange": task_of(exchanged, single, ["R"], {}, None),
    }
    return {name: (simulation_of(task), [2] * len(task.steps)) for name, task in tasks.items()}


@pytest.mark.parametrize("name", ["pair", "co-simulation", "model exchange"])
def test_no_index_that_points_nowhere_gets_through(runs: dict[str, Planned], name: str) -> None:
    simulation, versions = runs[name]
    plan, grid = simulation.plan, simulation.grid
    check_plan(plan, grid, versions)
    for i, operation in enumerate(plan.operations):
        meaningless = ("component", "n_values", "wire", "when") if operation.function == codes.COPY else ()
        for field in set(Operation._fields) - set(meaningless):
            for wrong in (-1, 2**62):
                spoilt = operation._replace(**{field: wrong})
                operations = (*plan.operations[:i], spoilt, *plan.operations[i + 1 :])
                with pytest.raises(ValueError, match="operations"):
                    check_plan(plan._replace(operations=operations), grid, versions)

    def refused(part: str, kind: str, array: Any) -> None:
        inputs = plan.inputs._replace(**{kind: array}) if part == "inputs" else plan.inputs
        changed = plan._replace(**{kind: array}) if part == "plan" else plan._replace(inputs=inputs)
        with pytest.raises(ValueError, match="of a plan"):
            check_plan(changed, grid._replace(**{kind: array}) if part == "grid" else grid, versions)

    for part, whole, kinds in (
        ("plan", plan, ("stages", "parameter_signals", "output_signals", "output_terms", "groups")),
        ("inputs", plan.inputs, ("signals", "modes", "slopes")),
        ("grid", grid, ("substeps", "strides")),
    ):
        for kind in kinds:
            given = getattr(whole, kind)
            refused(part, kind, given.astype(np.int32))
            if kind not in ("parameter_signals", "output_signals", "output_terms"):
                refused(part, kind, given[:-1] if kind != "groups" else given[:, :1])
            for place in np.ndindex(given.shape):
                for wrong in (-7, -(2**62), *([2**62] if part != "grid" else [])):  # many substeps are not wrong
                    changed = given.copy()
                    changed[place] = wrong
                    refused(part, kind, changed)
    refused("grid", "times", np.where(grid.times > 0.0, np.nan, grid.times))


def test_arrays_of_other_shapes_are_refused(runs: dict[str, Planned]) -> None:
    simulation, _ = runs["pair"]
    right = np.zeros((3, 1)), np.zeros((3, TIMES.size, 1)), new_reports(3)
    check_arrays(simulation.plan, simulation.grid, *right)
    for i, name in enumerate(("thetas", "outputs", "reports")):
        for wrong in (right[i][:, :0], right[i].astype(np.float32), np.asfortranarray(np.repeat(right[i], 2, 1))):
            arrays: list[Any] = list(right)
            arrays[i] = wrong
            with pytest.raises(ValueError, match=name):
                check_arrays(simulation.plan, simulation.grid, *arrays)
    with pytest.raises(ValueError, match="outputs"):
        check_arrays(simulation.plan, simulation.grid, right[0], right[1][:2], right[2])


# --- what it does


@pytest.mark.parametrize("value", [2.0**31, -(2.0**31) - 1])
def test_a_value_that_the_type_of_its_variable_cannot_hold_is_said(probe: ProbeMaker, value: float) -> None:
    simulator = Simulator(probe(), record(TIMES, {"n": [0.0, 1.0, 2.0, value, 0.0]}, ["ten_n"]))
    with pytest.raises(SimulationError, match=r"a value is out of range") as error:
        simulator([])
    assert error.value.time == TIMES[3]


TWO_INPUTS = """
model Sum
  input Real u;
  input Real v;
  output Real x(start = 0, fixed = true);
equation
  der(x) = 10 * (u + v) - x;
end Sum;
"""


def test_held_inputs_beside_those_that_go_by_midpoints(tmp_path: Path) -> None:
    """An FMU that cannot interpolate: the first substep of an interval must have the held input as of its beginning."""
    rng = np.random.default_rng(5)
    times, v = np.linspace(0.0, 1.0, 21), rng.normal(size=21)
    experiment = record(times, {"u": 0.0, "v": v}, ["x"], {"u": "linear", "v": "zoh"})
    got = Simulator(export_text(tmp_path, TWO_INPUTS, fmi="3.0"), experiment, interface="co-simulation")([])[:, 0]
    x = np.zeros(21)
    for k, h in enumerate(np.diff(times)):
        x[k + 1] = 10 * v[k] + (x[k] - 10 * v[k]) * np.exp(-h)
    assert np.abs(got - x).max() < 1e-6


@pytest.mark.parametrize(("model", "interpolation"), [("machine", "zoh"), ("machine", "linear"), ("failing", "zoh")])
def test_whole_rows_go_through_as_each_sample_does(probe: ProbeMaker, model: str, interpolation: str) -> None:
    """The walk over whole rows against the general one: the same bits, and of failures the same report."""
    rng, times = np.random.default_rng(3), np.array([0.0, 0.1, 0.2, 0.2, 0.3, 0.45])
    if model == "machine":
        path, inputs, outputs = FMUS / "InductionMachine" / "InductionMachine.fmu", ["uds", "uqs", "w"], ["ids", "iqs"]
        parameters, thetas = ["Rs"], np.array([[9.8], [5.0]])
    else:
        path, inputs, outputs, parameters = probe(), ["u"], ["y"], ["fail_at"]
        thetas = np.array([[9.0], [0.25], [0.05]])
    experiment = record(times, {name: rng.normal(size=6) for name in inputs}, outputs, interpolation)
    system = System(path, numerics=Numerics("co-simulation"))
    simulation = simulation_of(task_of(system, experiment, parameters, {}, None))
    (component,) = system.components.values()
    found = []
    for by_rows in (True, False):
        instance, used = Instance(component.fmu, component.kind, "x"), np.zeros(1, np.intp)
        loop = SimulationLoop(simulation.plan, simulation.grid, [instance], used)
        assert loop._plan.by_rows
        loop._plan.by_rows = by_rows
        got, reports = np.zeros((len(thetas), 6, len(outputs))), new_reports(len(thetas))
        loop.run(thetas, got, reports)
        found.append((got.tobytes(), reports.tolist()))
        instance.close()
    assert found[0] == found[1]
    assert np.abs(np.frombuffer(found[0][0])).max() > 0.0
    assert (found[0][1][1][0] >= 0) == (model == "failing")


def test_messages_are_formatted_and_bounded() -> None:
    log, text = library.core().Log(), ctypes.c_char_p
    told = ctypes.cast(library.core().log_open(ctypes.byref(log)), ctypes.POINTER(ctypes.c_void_p))
    say = ctypes.CFUNCTYPE(None, ctypes.c_void_p, text, ctypes.c_int32, text, text)(told[0])
    assert told[4] == ctypes.addressof(log)
    say(ctypes.byref(log), b"name", 1, b"category", b"%s of %d", text(b"seven"), ctypes.c_int(9))
    say(ctypes.byref(log), b"name", 3, b"category", b"%s", text(b"x" * 10_000))
    say(ctypes.byref(log), b"name", 0, None, None)
    assert (log.messages[0].status, log.messages[0].text) == (1, b"seven of 9")
    assert len(log.messages[1].text) == 2047
    for _ in range(100):
        say(ctypes.byref(log), b"name", 0, b"category", b"again")
    assert log.count == len(log.messages) == 20
    say(None, b"name", 0, b"category", b"to nobody")


TESTS = [
    *(f"simulation/fmi/test_{name}" for name in ("native", "integrators", "model_exchange")),
    *("simulation/fmi/test_float_environment", "simulation/test_sensitivities", "simulation/test_simulator"),
    *("models/test_system", "models/test_loops"),
]


@pytest.mark.slow
@needs_sanitizers
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    library = tmp_path / "core.so"
    flags = ["-std=c11", "-ffp-contract=off", build.DEFINED, *SANITIZE]
    subprocess.run(["gcc", *flags, *map(str, build.sources()), "-o", str(library), "-lm"], check=True)
    assert_nothing_found("tests.support.sanitized_core", TESTS, SANITIZED_CORE=str(library))


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("name", sorted(path.stem for path in FMUS.glob("*/*.fmu")))
@pytest.mark.parametrize(
    "count", [pytest.param(200, marks=pytest.mark.slow), pytest.param(2000, marks=pytest.mark.campaign)]
)
def test_simulations_leave_nothing_behind(name: str, kind: str, count: int) -> None:
    """Ten times as many simulations are the same bit for bit, and take no more memory than the first tenth."""
    fmu = FMU(FMUS / name / f"{name}.fmu")
    if kind not in fmu.description.interfaces:
        pytest.skip("it has no such interface")
    variables = fmu.description.variables.items()
    inputs = [name for name, variable in variables if variable.causality == "input"]
    outputs = [name for name, variable in variables if variable.causality == "output"]
    experiment = record(np.linspace(0.0, 3e-3, 4), {name: 0.1 * (k + 1) for k, name in enumerate(inputs)}, outputs[:3])
    simulator = Simulator(System(fmu.path, numerics=Numerics(kind)), experiment)
    first = simulator([])
    process, sizes = psutil.Process(), []
    for _ in range(10):
        found = simulator(np.zeros((count, 0)))
        assert (found == first).all()
        sizes.append(process.memory_info().rss)
    simulator.close()
    assert sizes[-1] - sizes[0] < 2e6
