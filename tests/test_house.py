"""The habits of the house: what may import what, what is documented, what is imported when."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import fmuid

PACKAGE = Path(fmuid.__file__).parent

# A module imports only from those above it; modules on one line do not import each other.
ORDER = """
errors text version
files mat_file toml_text processes
tables
transforms excitation
experiment
fmi.safe_xml
fmi.zipped fmi.start_values
fmi.unpacking
fmi.description
fmi.archive
ssv
ssd
ssp_links
ssp_values
ssp
fmi.codes fmi.native
fmi.kernels
fmi.layout fmi.instance fmi.conversions fmi.coupling fmi.discards fmi.co_simulation
fmi.block
fmi.runge_kutta fmi.events fmi.cvode
fmi.sensitivities
fmi.advance
fmi.integrators
fmi.model_exchange
fmi.loop
component
system
fmu_facts roles
plan
in_process
host
host_process
isolation
workers
simulator
smoke
validation
parameters
noise losses
sensitivity
model_sensitivity
forward_run
forward
predictors
problem
criterion
estimators.linear estimators.steps estimators.box estimators.records
estimators.radius
estimators.marquardt
covariance
local_model history
result
misfit
identification
criterion_map conditional chains
profile
posterior
series
residual_series
residuals
consistency
reading
estimators.global_search
uncertainty
study_file fit
report
decision faults
hypothesis
verdict
diagnosis
study_settings
study_parameters
study_diagnosis study_batch
study
draws case_problem
cases
case_run
case_host
bundle dataset scratch worker_host
workshop
cluster
batch
batch_statistics
batch_words
batch_summary
study_init alarms belief windows
window_fit
monitoring detectability
study_monitoring
plots
figures_panels
figures_starts
figures_diagnosis figures_fit figures_map figures_monitoring figures_residuals figures_search figures_uncertainty
figures_batch figures_run
export
apply
console
console_result console_batch console_diagnosis console_fmu console_monitoring progress
cli_words interruption
cli_batch cli_models cli_studies
cli
__main__
"""
RANK = {name: rank for rank, line in enumerate(ORDER.split("\n")) for name in line.split()}
EXTRAS = {"casadi", "pymoca", "antlr4", "ziglang"}


def modules() -> dict[str, Path]:
    """Return every module of the package below its name, packages' own files left out where they are empty of code."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts[-1] != "__init__":
            found[".".join(parts)] = path
    return found


def rank(module: str) -> int:
    """Return how far down a module stands; those of a package that is listed as a whole stand together."""
    return RANK[module if module in RANK else module.partition(".")[0]]


def imports(path: Path) -> set[str]:
    """Return the modules of the package that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            names |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
    inside = {name.removeprefix("fmuid.") for name in names if name.startswith("fmuid.")}
    known = modules()
    return {name for name in inside if name in known or name in RANK}


def test_every_module_has_its_place() -> None:
    strangers = [name for name in modules() if name not in RANK and name.partition(".")[0] not in RANK]
    assert not strangers
    there = {*modules(), *(path.parent.name for path in PACKAGE.glob("*/__init__.py"))}
    assert not [name for name in RANK if name not in there]


@pytest.mark.parametrize("module", modules())
def test_imports_only_from_above(module: str) -> None:
    own = module.partition(".")[0]
    for imported in imports(modules()[module]):
        if own not in RANK or imported.partition(".")[0] != own:  # inside a package listed as a whole there is no order
            assert rank(imported) < rank(module), f"{module} imports {imported}, which stands below it"


def test_imports_are_seen() -> None:
    assert {"errors", "study_file", "parameters"} <= imports(PACKAGE / "study.py")
    assert "console" in imports(PACKAGE / "cli_studies.py")


@pytest.mark.parametrize("module", [name for name in modules() if not name.startswith("export") and name != "__main__"])
def test_public_is_documented(module: str) -> None:
    found = importlib.import_module(f"fmuid.{module}")
    assert found.__doc__
    for name, value in vars(found).items():
        if name.startswith("_") or getattr(value, "__module__", None) != found.__name__:
            continue
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{module}.{name} has no docstring"
        if inspect.isclass(value):
            for member, method in vars(value).items():
                if not member.startswith("_") and isinstance(
                    method, property | classmethod | staticmethod
                ) | inspect.isfunction(method):
                    assert inspect.getdoc(getattr(value, member)) or inspect.getdoc(method), f"{module}.{name}.{member}"


@pytest.mark.parametrize("name", fmuid.__all__)
def test_public_names_resolve(name: str) -> None:
    value = getattr(fmuid, name)
    assert callable(value)
    assert name in dir(fmuid)
    assert value.__module__ != "fmuid"


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Fmu'"):
        fmuid.Fmu  # noqa: B018


@pytest.mark.parametrize("module", ["fmuid", "fmuid.cli"])
def test_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*(name for name in sys.modules if '.' not in name))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "fmuid" in loaded
    assert not loaded & {"numpy", "pandas", "numba", "matplotlib", "fmpy", "scipy", "pyarrow", *EXTRAS}


def test_only_figures_import_matplotlib() -> None:
    users = {name for name, path in modules().items() if "matplotlib" in path.read_text(encoding="utf-8")}
    assert users >= {"plots", "figures_fit"}
    assert all(name == "plots" or name.startswith("figures_") for name in users)
