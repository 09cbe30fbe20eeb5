"""Results carried out: the SSV file of the estimates, and copies of FMUs that start at them."""

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from fmpy.ssp import ssd as fmpy_ssd
from fmpy.validation import validate_fmu

from fmuid import FMU, Experiment, InputError, Result, Simulator, System
from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.models import Quantity, Unit, read_ssv, with_starts, write_ssv
from fmuid.runs import AppliedValue, apply_result
from fmuid.runs.apply import write_estimates
from tests.support.fmu_texts import FMI_3
from tests.support.paths import FMUS
from tests.support.results import result

COIL, DRIVE = (FMUS / name / f"{name}.fmu" for name in ("Coil", "PositionDrive"))
Values = dict[str, tuple[float, float | None]]


def description(fmu: Path) -> bytes:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read("modelDescription.xml")


def test_copy_differs_in_the_start_values_only(tmp_path: Path) -> None:
    new = tmp_path / "deep" / "New.fmu"
    R, L = apply_result(result(tmp_path, {"R": (4.25, 0.01), "L": (0.125, 0.002)}), COIL, new)
    assert AppliedValue("R", 4.0, 4.25, pytest.approx(0.01), "Ohm") == R  # type: ignore[arg-type]
    assert AppliedValue("L", 0.1, 0.125, pytest.approx(0.002), "H") == L  # type: ignore[arg-type]
    with zipfile.ZipFile(COIL) as old, zipfile.ZipFile(new) as copy:
        assert copy.testzip() is None
        for one, other in zip(old.infolist(), copy.infolist(), strict=True):
            for name in ("filename", "date_time", "external_attr", "compress_type"):
                assert getattr(one, name) == getattr(other, name)
            assert (old.read(one) == copy.read(other)) is (one.filename != "modelDescription.xml")
    before, after = description(COIL).decode().splitlines(), description(new).decode().splitlines()
    kept = [line for line in after if "VendorAnnotations" not in line]
    changed = [(a, b) for a, b in zip(before, kept, strict=True) if a != b]
    assert len(changed) == 2
    assert all(a.replace("4.0", "4.25").replace("0.1", "0.125") == b for a, b in changed)
    assert validate_fmu(str(new)) == []
    assert FMU(new).description.applied == {"R": 4.25, "L": 0.125}


def test_copy_simulates_as_the_original_at_the_estimates(tmp_path: Path) -> None:
    """The binary has its own start values: what the annotation lists is set, and gives the coil of those values."""
    new, R, L, times = tmp_path / "New.fmu", 4.0 + 1 / 3, 0.1 * math.pi, np.arange(100) * 1e-3
    apply_result(result(tmp_path, {"R": (R, 0.01), "L": (L, 0.002)}), COIL, new)
    experiment = Experiment(pd.DataFrame({"time": times, "u": 1.0, "i": 0.0}), ["u"], ["i"])
    simulated = Simulator(new, experiment)([])
    np.testing.assert_array_equal(simulated, Simulator(COIL, experiment, values={"R": R, "L": L})([]))
    np.testing.assert_allclose(simulated[:, 0], (1 - np.exp(-R / L * times)) / R, rtol=1e-9, atol=1e-12)


def ssv(tmp_path: Path, values: dict[str, Quantity], units: Any = None) -> Path:
    write_ssv(tmp_path / "x.ssv", "n", values, units or {})
    return tmp_path / "x.ssv"


def unit(name: str, factor: float) -> dict[str, Unit]:
    return {name: Unit(name, (1, 2, -2, -2, 0, 0, 0, 0), factor, 0.0, {})}  # kg.m2.s-2.A-2


def test_ssv_file_is_applied_in_the_units_of_the_fmu(tmp_path: Path) -> None:
    given = ssv(tmp_path, {"L": Quantity(150.0, "mH"), "R": Quantity(5)}, unit("mH", 1e-3))
    applied = apply_result(given, COIL, tmp_path / "New.fmu")
    assert [each.new for each in applied] == [pytest.approx(0.15, rel=1e-15), 5]
    assert all(math.isnan(each.std) for each in applied)
    assert FMU(tmp_path / "New.fmu").description.applied["R"] == 5.0


def test_component_of_a_system(tmp_path: Path) -> None:
    models = {"drive": {"name": "PositionDrive", "digest": "0"}, "pc": {"name": "PositionController", "digest": "1"}}
    path = result(tmp_path, {"drive.M": (90.0, 1.0), "pc.kp": (150.0, 2.0), "drive.Fv": (200.0, 3.0)}, models=models)
    assert [each.variable for each in apply_result(path, DRIVE, tmp_path / "New.fmu", "drive")] == ["M", "Fv"]
    for component, said in (((), "--component"), (("drvie",), "'drive'"), (("pc",), "PositionController")):
        with pytest.raises(InputError, match=said):
            apply_result(path, DRIVE, tmp_path / "New.fmu", *component)


@pytest.mark.parametrize(
    ("values", "changes", "message"),
    [
        ({"Rs": (4.0, 0.1)}, {}, "'Rs'.*'R'"),
        ({"i": (4.0, 0.1)}, {}, "i: start value is not settable"),
        ({"R[first]": (4.0, 0.1)}, {}, r"R\[first\]: estimated for one experiment"),
        ({"R": (-4.0, 0.1)}, {}, "-4 .*min = 0"),
        ({"R": (4.0, None), "L": (0.1, 0.01)}, {}, "R"),
        ({"R": (4.0, 0.1)}, {"outcome": "iteration_limit", "converged": False}, "iteration_limit"),
        ({"R": (4.0, 0.1)}, {"models": {"": {"name": "Motor", "digest": "0"}}}, "Motor.*Coil"),
        ({"R": Quantity("text")}, {}, "text 'text'"),
        ({"R": Quantity(True)}, {}, "True is no start value"),
        ({"R": Quantity(1.0, "H")}, {}, "'H' does not convert to 'Ohm'"),
        ({}, {}, r"x\.ssv: no parameters$"),
    ],
)
def test_values_that_cannot_be_applied_are_refused(
    tmp_path: Path, values: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    of_result = any(type(each) is tuple for each in values.values())
    path = result(tmp_path, values, **changes) if of_result else ssv(tmp_path, values, unit("H", 1.0))
    with pytest.raises(InputError, match=message):
        apply_result(path, COIL, tmp_path / "New.fmu")
    assert not (tmp_path / "New.fmu").exists()


def test_fmi_3(tmp_path: Path) -> None:
    source, new = tmp_path / "Old.fmu", tmp_path / "New.fmu"
    with zipfile.ZipFile(source, "w") as archive:
        archive.writestr("modelDescription.xml", FMI_3)
        archive.comment = b"made by hand"
    applied = apply_result(ssv(tmp_path, {"A[2,3]": Quantity(7.5), "k": Quantity(-3)}), source, new)
    assert [(each.variable, each.old, each.new) for each in applied] == [("A[2,3]", 6.0, 7.5), ("k", -1, -3)]
    assert description(new) == with_starts(FMI_3.encode(), {"A[2,3]": 7.5, "k": -3})
    with zipfile.ZipFile(new) as archive:
        assert archive.comment == b"made by hand"
    with pytest.raises(InputError, match="structuralParameter"):
        apply_result(ssv(tmp_path, {"n": Quantity(2)}), source, new)
    with pytest.raises(InputError, match="is the FMU itself"):
        apply_result(ssv(tmp_path, {"k": Quantity(2)}), new, new)
    assert b"made by hand" in new.read_bytes()


def test_apply_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result(tmp_path, {"R": (4.2512, 0.0123), "L": (0.125, 0.002)})
    new = tmp_path / "New.fmu"
    assert run(["apply", str(tmp_path), str(COIL), "-o", str(new)]) == DONE
    out, error = capsys.readouterr()
    rows = [line.split() for line in out.splitlines()]
    assert error == "" and "New.fmu" in out
    assert ["R", "4", "4.251", "0.012", "Ohm"] in rows and ["L", "0.1", "0.1250", "0.0020", "H"] in rows
    assert FMU(new).description.applied == {"R": 4.2512, "L": 0.125}
    assert run(["apply", str(tmp_path / "gone"), str(COIL), "-o", str(new)]) == WRONG_INPUT


def estimated(folder: Path, values: Values, **changes: Any) -> Result:
    return Result.from_json(result(folder, values, **changes))


def test_estimates_are_written_as_ssv(tmp_path: Path) -> None:
    values: Values = {"a.R": (4.1 / 3, 0.0123), "b.L": (0.1, 1e-3), "b.R": (4.0, None), "a.i_start[x]": (1.0, 0.1)}
    (path,) = write_estimates(tmp_path, System(components={"a": COIL, "b": COIL}), estimated(tmp_path, values), {})
    assert path == tmp_path / "parameters.ssv"
    read = fmpy_ssd.read_ssv(str(path), validate=True).parameters
    assert [(p.name, float(p.value), p.unit) for p in read] == [("a.R", 4.1 / 3, "Ohm"), ("b.L", 0.1, "H")]
    own = read_ssv(path)
    assert own.values["a.R"].description == "standard deviation 0.0123 Ohm"
    assert own.units["Ohm"].exponents == (1, 2, -3, -2, 0, 0, 0, 0)
    text = description(COIL).decode()
    changed = text.replace('<Unit name="H"><BaseUnit ', '<Unit name="H"><BaseUnit factor="2" ')
    assert changed != text
    with zipfile.ZipFile(tmp_path / "Other.fmu", "w") as other:
        other.writestr("modelDescription.xml", changed)
    system = System(components={"a": COIL, "b": tmp_path / "Other.fmu"})  # which defines H otherwise
    (path,) = write_estimates(tmp_path, system, estimated(tmp_path, {"a.L": (0.1, 0.01), "a.R": (4.0, 0.1)}), {})
    assert {name: each.unit for name, each in read_ssv(path).values.items()} == {"a.L": None, "a.R": "Ohm"}


def test_estimates_written_and_applied_again_are_the_same(tmp_path: Path) -> None:
    found = estimated(tmp_path, {"R": (math.pi, 0.01), "L": (math.e / 10, 0.01)})
    (path,) = write_estimates(tmp_path, System(COIL), found, {})
    applied = apply_result(path, COIL, tmp_path / "New.fmu")
    assert {each.variable: each.new for each in applied} == {"R": math.pi, "L": math.e / 10}
    for std, changes in ((0.1, {"outcome": "stalled"}), (None, {})):  # no file without a reliable value
        path.write_text("of an earlier run")
        assert write_estimates(tmp_path, System(COIL), estimated(tmp_path, {"R": (4.0, std)}, **changes), {}) == []
        assert not path.exists()
