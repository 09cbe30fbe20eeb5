"""The exporter's FMI 3.0: the twin of its FMI 2.0, through FMPy's low-level calls."""

from pathlib import Path

import numpy as np
import pytest

from fmuid import InputError
from fmuid.export import export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import running
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
