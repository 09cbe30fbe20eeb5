"""The exporter's FMI 3.0: the twin of its FMI 2.0, through FMPy's low-level calls."""

from __future__ import annotations

import re
import struct
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmuid.errors import InputError
from fmuid.export import export_fmu
from fmuid.simulation.native.build import compiler_here
from tests.support.exported import export_text, running
from tests.support.modelica import FRICTION
from tests.support.paths import FMUS

MODELS = ["Coil", "InductionMachine", "PositionController", "PositionDrive"]
Twins = dict[str, tuple[Path, Path]]


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Twins:
    """Model -> its FMU 2.0 and its FMU 3.0."""
    folder = tmp_path_factory.mktemp("twins")
    found = {}
    for name in MODELS:
        text = (FMUS / name / f"{name}.mo").read_text(encoding="utf-8")
        pair = []
        for version in ("2.0", "3.0"):
            (folder / version).mkdir(exist_ok=True)
            pair.append(export_text(folder / version, text, fmi=version))
        found[name] = (pair[0], pair[1])
    return found


def changed(description: list[str], rng: np.random.Generator) -> dict[str, float]:
    return {name: rng.uniform(0.5, 1.5) for name in description}


models = pytest.mark.parametrize("model", MODELS)


@models
def test_co_simulation_is_that_of_fmi_2(twins: Twins, model: str) -> None:
    """Random parameters and held inputs, irregular steps: not a bit differs."""
    rng = np.random.default_rng(1)
    with running(twins[model][0]) as two, running(twins[model][1]) as three:
        names = {v.name: v.causality for v in two.description.modelVariables}
        assert {v.name: v.causality for v in three.description.modelVariables} == names | {"time": "independent"}
        inputs = [name for name, causality in names.items() if causality == "input"]
        starts = {v.name: float(v.start) for v in two.description.modelVariables if v.causality == "parameter"}
        starts = {name: (value or 0.1) * rng.uniform(0.9, 1.1) for name, value in starts.items()}
        assert three.fmu.getVersion() == "3.0"
        for each in (two, three):
            each.initialise(starts, start=0.25)
        t = 0.25
        for h in rng.uniform(2e-4, 3e-3, 50):
            values = {name: rng.uniform(-10, 10) for name in inputs}
            for each in (two, three):
                each.set(values)
            assert two.get(*names) == three.get(*names)
            for each in (two, three):
                each.run(h, start=t)
            t += h
            assert two.get(*names) == three.get(*names)
        assert three.get("time") == [t]
        final = three.get(*names)
        three.fmu.reset()
        three.initialise(starts, start=0.25)
        assert three.get("time") == [0.25]
        assert three.get(*names) != final


@models
def test_model_exchange_is_that_of_fmi_2(twins: Twins, model: str) -> None:
    rng = np.random.default_rng(2)
    with running(twins[model][0], True) as two, running(twins[model][1], True) as three:
        variables = two.description.modelVariables
        inputs = [v.name for v in variables if v.causality == "input"]
        computed = [v.name for v in variables if v.causality != "parameter" and v.name not in inputs]
        rates = [v for v in variables if v.derivative is not None]
        for each in (two, three):
            each.initialise()
            each.update()
        for _ in range(5):
            x, u = rng.uniform(-1, 1, len(rates)), {name: rng.uniform(-10, 10) for name in inputs}
            for each in (two, three):
                each.set(u)
                each.at(0.5, *x)
            assert two.derivatives() == three.derivatives()
            assert two.get(*computed) == three.get(*computed)
            assert three.indicators() == []
            for known in [*inputs, *(v.derivative.name for v in rates)]:
                found = [
                    each.fmu.getDirectionalDerivative(
                        [each.references[n] for n in computed], [each.references[known]], [1.0]
                    )
                    for each in (two, three)
                ]
                assert list(found[0]) == list(found[1])


@models
def test_fmpy_finds_nothing_to_say(twins: Twins, model: str) -> None:
    assert validate_fmu(str(twins[model][1])) == []


def test_description_of_a_model_with_events(tmp_path: Path) -> None:
    fmu = export_text(tmp_path, FRICTION, fmi="3.0")
    assert validate_fmu(str(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
    variables = {v.get("valueReference"): v for v in root.iter("Float64")}
    names = {reference: v.get("name") for reference, v in variables.items()}
    structure = {
        (element.tag, names[element.get("valueReference")]): {
            names[r] for r in element.get("dependencies", "?").split()
        }
        for element in root.findall("ModelStructure/*")
    }
    assert structure == {
        ("Output", "x"): {"x"},
        ("Output", "v"): {"v"},
        ("Output", "impulse"): {"impulse"},
        ("ContinuousStateDerivative", "der(x)"): {"v"},
        ("ContinuousStateDerivative", "der(v)"): {"v", "F"},
        ("ContinuousStateDerivative", "der(impulse)"): {"v"},
        ("InitialUnknown", "x"): set(),
        ("InitialUnknown", "v"): {"v_start"},
        ("InitialUnknown", "impulse"): set(),
        ("InitialUnknown", "der(x)"): {"v_start"},
        ("InitialUnknown", "der(v)"): {"v_start", "m", "F", "Fc"},
        ("InitialUnknown", "der(impulse)"): {"v_start", "Fc"},
        ("EventIndicator", "relation[1]"): {"v"},
        ("EventIndicator", "relation[2]"): {"v"},
    }
    derivatives = {v.get("name"): names[v.get("derivative")] for v in variables.values() if v.get("derivative")}
    assert derivatives == {"der(x)": "x", "der(v)": "v", "der(impulse)": "impulse"}
    interface = {k: v for k, v in root.find("CoSimulation").attrib.items() if k != "modelIdentifier"}  # type: ignore[union-attr]
    assert interface == {
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "canHandleVariableCommunicationStepSize": "true",
        "canReturnEarlyAfterIntermediateUpdate": "false",
        "mightReturnEarlyFromDoStep": "false",
        "hasEventMode": "false",
    }


def test_time_is_a_dependency(tmp_path: Path) -> None:
    text = "model Clock output Real y; equation y = 2*time; annotation(experiment(StopTime=1, Interval=1)); end Clock;"
    with running(export_text(tmp_path, text, fmi="3.0")) as clock:
        (output,) = clock.description.outputs
        assert [each.name for each in output.dependencies] == ["time"]
        clock.initialise(start=3.0)
        assert clock.get("time", "y") == [3.0, 6.0]
        clock.run(0.5, start=3.0)
        assert clock.get("time", "y") == [3.5, 7.0]


def test_state_is_saved_restored_and_serialised(twins: Twins) -> None:
    with running(twins["InductionMachine"][1]) as one, running(twins["InductionMachine"][1]) as other:
        one.initialise({"uds": 100.0})
        other.initialise()
        one.run(*[1e-3] * 5)
        state = one.fmu.getFMUState()
        data = one.fmu.serializeFMUState(state)
        one.run(*[1e-3] * 5, start=5e-3)
        expected = one.get("ids", "iqs", "time")
        copy = other.fmu.deserializeFMUState(data)
        for each, saved in ((one, state), (other, copy)):
            each.fmu.setFMUState(saved)
            each.run(*[1e-3] * 5, start=5e-3)
            assert each.get("ids", "iqs", "time") == expected
            each.fmu.freeFMUState(saved)
    with running(twins["Coil"][1]) as coil:
        assert "these bytes are not a state of this FMU" in coil.refused(lambda: coil.fmu.deserializeFMUState(data))


def test_refusals(twins: Twins) -> None:
    with running(twins["Coil"][1]) as coil:
        for call, text in (
            (lambda: coil.set({"i": 1.0}), "fmi3SetFloat64: i is computed by the model: only inputs and parameters"),
            (lambda: coil.set({"time": 1.0}), "fmi3SetFloat64: time is computed by the model"),
            (lambda: coil.set({"u": np.nan}), "fmi3SetFloat64: the value given for u at t = 0 is not finite"),
            (lambda: coil.fmu.getFloat64([99]), "fmi3GetFloat64: there is no variable of value reference 99"),
            (lambda: coil.fmu.getInt32([0]), "fmi3GetInt32: all variables of the model are Float64"),
            (lambda: coil.fmu.enterStepMode(), "fmi3EnterStepMode: not provided"),
            (lambda: coil.run(-1.0), "fmi3DoStep: from t = 0 by -1 is no step"),
        ):
            coil.initialise()
            assert text in coil.refused(call)
            assert "after an error (reset the instance" in coil.refused(lambda: coil.get("i"))
            coil.fmu.reset()
        assert "fmi3DoStep cannot be called before initialization mode" in coil.refused(lambda: coil.run(1e-3))
        component = coil.fmu.component
        for options in ({"eventModeUsed": True}, {"requiredIntermediateVariables": [1]}):
            with pytest.raises(Exception, match="Failed to instantiate"):
                coil.fmu.instantiate(logMessage=coil.callback, **options)
        assert "hasEventMode is false" in coil.messages[-2]
        assert "providesIntermediateUpdate is false" in coil.messages[-1]
        coil.fmu.guid = "another"
        with pytest.raises(Exception, match="Failed to instantiate"):
            coil.instantiate()
        assert "modelDescription.xml and binary are not of the same export" in coil.messages[-1]
        coil.fmu.component = component


def test_unknown_version(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no export to FMI '1\.0': give one of 2\.0, 3\.0"):
        export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "Coil.fmu", fmi="1.0")


@pytest.mark.slow
def test_binaries_and_bytes(tmp_path: Path) -> None:
    """Binaries for four platforms with all of FMI 3.0's functions; the same bytes again from elsewhere."""
    first = export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "first.fmu", fmi="3.0")
    (tmp_path / "Moved.mo").write_bytes((FMUS / "Coil" / "Coil.mo").read_bytes())
    assert export_fmu(tmp_path / "Moved.mo", fmi="3.0").read_bytes() == first.read_bytes()
    with zipfile.ZipFile(first) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    functions = set(re.findall(rb"\bfmi3\w+(?=TYPE\s+fmi3)", files["sources/fmi3Functions.h"]))
    assert len(functions) > 70
    binaries = {name.split("/")[1]: data for name, data in files.items() if name.startswith("binaries/")}
    assert {*binaries} == {"x86_64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin"}
    assert binaries["x86_64-linux"][:5] == b"\x7fELF\x02"
    assert binaries["x86_64-windows"][:2] == b"MZ"
    for platform, cpu in (("x86_64-darwin", 0x01000007), ("aarch64-darwin", 0x0100000C)):
        assert struct.unpack_from("<2I", binaries[platform]) == (0xFEEDFACF, cpu)
    for data in binaries.values():
        assert not [f for f in functions if b"\0" + f + b"\0" not in data and b"\0_" + f + b"\0" not in data]
        assert str(FMUS.parent).encode() not in data


def test_sources_rebuild(twins: Twins, tmp_path: Path) -> None:
    """As buildDescription.xml says."""
    fmpy.extract(str(twins["Coil"][1]), unzipdir=str(tmp_path))
    root = ET.parse(tmp_path / "sources" / "buildDescription.xml").getroot()
    (configuration,) = root
    assert configuration.get("modelIdentifier") == "Coil"
    sources = [str(each.get("name")) for each in root.iter("SourceFile")]
    assert sources == ["fmi3.c"]
    command = [*compiler_here(), "-std=c99", "-Wall", "-shared", "-fPIC", *sources, "-o", "x.so"]
    done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
