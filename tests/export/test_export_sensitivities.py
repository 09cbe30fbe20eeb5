"""Models exported with sensitivity outputs: the derivatives of the outputs with respect to parameters."""

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
