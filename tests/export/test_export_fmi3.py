"""Exported FMUs of FMI 3.0, and outputs of sensitivities: against FMI 2.0, closed forms and differences."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import InputError
from fmuid.export import export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import Running, running
from tests.support.modelica import DRIVE
from tests.support.paths import FMUS
from tests.support.quick import first

models = pytest.mark.parametrize("model", first(1, ["PositionController", "InductionMachine"]))


def source(model: str) -> str:
    return (FMUS / model / f"{model}.mo").read_text(encoding="utf-8")


@models
def test_model_exchange_is_that_of_fmi_2(exported: Exporter, model: str) -> None:
    rng = np.random.default_rng(2)
    text = source(model)
    with running(exported(text, fmi="2.0"), True) as two, running(exported(text, fmi="3.0"), True) as three:
        variables = two.description.modelVariables
        inputs = [v.name for v in variables if v.causality == "input"]
        computed = [v.name for v in variables if v.causality != "parameter" and v.name not in inputs]
        rates = [v for v in variables if v.derivative is not None]
        for each in (two, three):
            each.initialize()
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
                assert two.slopes(computed, known) == three.slopes(computed, known)


def test_state_is_saved_restored_and_serialized(exported: Exporter) -> None:
    machine = exported(source("InductionMachine"), fmi="3.0")
    with running(machine) as one, running(machine) as other:
        one.initialize({"uds": 100.0})
        other.initialize()
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
    with running(exported(source("Coil"), fmi="3.0")) as coil:
        assert "these bytes are not a state of this FMU" in coil.refused(lambda: coil.fmu.deserializeFMUState(data))


def test_refusals(exported: Exporter) -> None:
    with running(exported(source("Coil"), fmi="3.0")) as coil:
        for call, text in (
            (lambda: coil.set({"i": 1.0}), "fmi3SetFloat64: i is computed by the model: only inputs and parameters"),
            (lambda: coil.set({"time": 1.0}), "fmi3SetFloat64: time is computed by the model"),
            (lambda: coil.set({"u": np.nan}), "fmi3SetFloat64: the value given for u at t = 0 is not finite"),
            (lambda: coil.fmu.getFloat64([99]), "fmi3GetFloat64: there is no variable of value reference 99"),
            (lambda: coil.fmu.getInt32([0]), "fmi3GetInt32: all variables of the model are Float64"),
            (lambda: coil.fmu.enterStepMode(), "fmi3EnterStepMode: not provided"),
            (lambda: coil.run(-1.0), "fmi3DoStep: from t = 0 by -1 is no step"),
        ):
            coil.initialize()
            assert text in coil.refused(call)
            assert "after an error (reset the instance" in coil.refused(lambda: coil.get("i"))
            coil.fmu.reset()
        assert "fmi3DoStep cannot be called before initialization mode" in coil.refused(lambda: coil.run(1e-3))
        component = coil.fmu.component
        for options, text in (
            ({"eventModeUsed": True}, "hasEventMode is false"),
            ({"requiredIntermediateVariables": [1]}, "providesIntermediateUpdate is false"),
        ):
            with pytest.raises(Exception, match="Failed to instantiate"):
                coil.fmu.instantiate(logMessage=coil.callback, **options)
            assert text in coil.messages[-1]
        coil.fmu.guid = "another"
        with pytest.raises(Exception, match="Failed to instantiate"):
            coil.instantiate()
        assert "modelDescription.xml and binary are not of the same export" in coil.messages[-1]
        coil.fmu.component = component


def test_unknown_version(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"1\.0.*2\.0.*3\.0"):
        export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "Coil.fmu", fmi="1.0")


PARAMETERS = {"R": 1.5, "L": 0.2, "k": 0.7, "J": 0.05, "i0": 0.4}


def simulate(drive: Running, names: list[str], values: dict[str, float]) -> np.ndarray:
    """Return variables at samples 30 ms apart under a voltage that changes from one to the next."""
    rng = np.random.default_rng(4)
    drive.initialize(values)
    rows = []
    for k in range(40):
        drive.set({"u": rng.uniform(-10, 10)})
        rows.append(drive.get(*names))
        drive.run(0.03, start=0.03 * k)
    drive.fmu.reset()
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_against_central_differences_of_whole_simulations(exported: Exporter, fmi: str) -> None:
    names = ["i", "p"]
    with (
        running(exported(DRIVE.replace("Drive", "Plain"), fmi=fmi)) as plain,
        running(exported(DRIVE, fmi=fmi, sensitivities="all")) as drive,
    ):
        found = simulate(drive, [*names, *(f"sens.{p}.{y}" for p in PARAMETERS for y in names)], {})
        np.testing.assert_array_equal(found[:, :2], simulate(plain, names, {}))  # they change nothing
        for k, (name, value) in enumerate(PARAMETERS.items()):

            def difference(h: float, name: str = name, value: float = value) -> Any:
                ends = [simulate(plain, names, {name: value + sign * h}) for sign in (1, -1)]
                return (ends[0] - ends[1]) / (2 * h)

            expected = (4 * difference(1e-4 * value) - difference(2e-4 * value)) / 3
            scale = np.abs(expected).max(0)
            assert np.all(scale > 1e-2)
            np.testing.assert_array_less(np.abs(found[:, 2 + 2 * k : 4 + 2 * k] - expected).max(0) / scale, 1e-6)


def test_against_the_closed_form(exported: Exporter) -> None:
    """A coil at rest under a constant voltage, in its start and along its course."""
    text = (FMUS / "Coil" / "Coil.mo").read_text()
    with running(exported(text, sensitivities=("R", "i_start", "R"))) as coil:
        R, L, i0, u = 4.0, 0.1, 2.0, 3.0
        coil.initialize({"u": u, "i_start": i0})
        assert coil.get("sens.R.i", "sens.i_start.i", "der(sens.R.i)") == [0.0, 1.0, -i0 / L]
        t = coil.run(*[0.001] * 30)
        decay = np.exp(-R / L * t)
        by_R = -u / R**2 * (1 - decay) - t / L * (i0 - u / R) * decay
        assert coil.get("i", "sens.R.i", "sens.i_start.i") == pytest.approx(
            [u / R + (i0 - u / R) * decay, by_R, decay], rel=1e-10
        )


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["R", "l"], r"Coil\.mo: no sensitivities to 'l', which is no parameter of the model \(did you mean 'L'\?\)"),
        (["u"], r"no sensitivities to 'u', which is no parameter of the model: the parameters are R, L, i_start"),
    ],
)
def test_unknown_parameters(tmp_path: Path, names: list[str], text: str) -> None:
    with pytest.raises(InputError, match=text):
        export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "Coil.fmu", sensitivities=names)
