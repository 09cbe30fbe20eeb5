"""What several tests share: the built FMUs and a probe FMU that misbehaves on demand."""

# ruff: noqa: E501  # the model description of the probe reads best one variable a line

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.compiled import ProbeMaker, write_fmu
from tests.support.paths import HERE
from tests.support.quick import draw_nothing

# readline, which pytest imports, exports the width of the terminal to all processes of a test.
os.environ.pop("COLUMNS", None)
# Commands that tests start would compile all that they import, every time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Shells start background jobs with Ctrl-C ignored, which the processes of these tests would inherit.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


_VARIABLES = """
<ScalarVariable name="gain" valueReference="0" causality="parameter" variability="tunable"><Real start="1"/></ScalarVariable>
<ScalarVariable name="fail_at" valueReference="1" causality="parameter" variability="fixed"><Real start="1e9" unit="s"/></ScalarVariable>
<ScalarVariable name="nan_at" valueReference="2" causality="parameter" variability="fixed"><Real start="1e9" unit="s"/></ScalarVariable>
<ScalarVariable name="fail_init" valueReference="3" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
<ScalarVariable name="u" valueReference="4" causality="input" variability="continuous"><Real start="0" unit="rad/s"/></ScalarVariable>
<ScalarVariable name="x" valueReference="5" causality="output" variability="continuous" initial="exact"><Real start="0" unit="rad"/></ScalarVariable>
<ScalarVariable name="y" valueReference="6" causality="output" variability="continuous"><Real/></ScalarVariable>
<ScalarVariable name="instances" valueReference="7" causality="output" variability="discrete"><Real/></ScalarVariable>
<ScalarVariable name="n" valueReference="0" causality="input" variability="discrete"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="ten_n" valueReference="1" causality="output" variability="discrete"><Integer/></ScalarVariable>
<ScalarVariable name="b" valueReference="0" causality="input" variability="discrete"><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="not_b" valueReference="1" causality="output" variability="discrete"><Boolean/></ScalarVariable>
<ScalarVariable name="word" valueReference="0" causality="parameter" variability="fixed"><String start="nothing"/></ScalarVariable>
<ScalarVariable name="twice" valueReference="8" causality="calculatedParameter" variability="fixed"><Real/></ScalarVariable>
<ScalarVariable name="z" valueReference="5" causality="output" variability="continuous"><Real/></ScalarVariable>
"""

_UNITS = """
<Unit name="rad/s"><BaseUnit s="-1" rad="1"/><DisplayUnit name="rpm" factor="9.549296585513721"/></Unit>
<Unit name="krad/s"><BaseUnit s="-1" rad="1" factor="1000"/></Unit>
<Unit name="rad"><BaseUnit rad="1"/><DisplayUnit name="deg" factor="57.29577951308232"/></Unit>
<Unit name="s"><BaseUnit s="1"/></Unit>
"""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Have the tests of a module run in one process, so that its fixtures are made once; spoiled inputs take longest."""
    from xdist.scheduler import LoadScopeScheduling

    scheduling = LoadScopeScheduling(config, log)
    scheduling._split_scope = lambda test: (
        test if "test_fuzz.py" in test else test.split("::", 1)[0].replace("test_census", "test_house")
    )
    return scheduling


@pytest.fixture
def blank_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are empty; figures are made and written, but nothing is laid out or drawn in them, which takes longer than all the rest."""
    if "drawn_figures" not in request.fixturenames:
        draw_nothing(monkeypatch)


@pytest.fixture
def drawn_figures() -> None:
    """Figures are drawn in a test of a module that has them blank."""


@pytest.fixture(scope="session")
def clean() -> pd.DataFrame:
    """The induction machine's record without noise, integrated once for all tests."""
    from experiments.induction_machine import make_table  # and with it scipy.signal

    return make_table.simulate()


@pytest.fixture
def nothing_said(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing that an FMU prints, and no traceback of its process, comes out of this one."""
    yield
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


@pytest.fixture(scope="session")
def probe(tmp_path_factory: pytest.TempPathFactory) -> ProbeMaker:
    """Return a function that builds the probe FMU: probe(*C defines, attributes of <CoSimulation>...)."""
    folder, source = tmp_path_factory.mktemp("probe"), HERE / "probe" / "probe.c"

    def make(*defines: str, feedthrough: str = "5", version: str = "2.0", **attributes: str) -> Path:
        attributes.setdefault("canHandleVariableCommunicationStepSize", "true")
        said = " ".join(f'{key}="{value}"' for key, value in attributes.items())
        outputs = "".join(f'<Unknown index="{i}"/>' for i in (6, 8, 10, 12)) + '<Unknown index="15" dependencies=""/>'
        xml = (
            f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{version}" modelName="Probe" '
            f'guid="probe"><CoSimulation modelIdentifier="probe" {said}/><UnitDefinitions>{_UNITS}</UnitDefinitions>'
            f"<ModelVariables>{_VARIABLES}</ModelVariables><ModelStructure><Outputs>{outputs}"
            f'<Unknown index="7" dependencies="{feedthrough}"/></Outputs></ModelStructure></fmiModelDescription>'
        )
        flags = ["-Wno-unused-parameter", *(f"-D{define}" for define in defines)]
        return write_fmu(folder / f"probe{abs(hash((defines, xml)))}.fmu", xml, source, *flags)

    return make


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return an exporter of the models in `tests.support.resting`, each once."""
    from tests.support.exported import export_text

    folder, known = tmp_path_factory.mktemp("resting"), dict[str, Path]()

    def export(text: str) -> Path:
        if text not in known:
            known[text] = export_text(folder, text)
        return known[text]

    return export
