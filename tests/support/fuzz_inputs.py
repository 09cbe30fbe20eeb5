"""What the fuzz tests spoil: a study of each kind with its files, and tables that are wrong already."""

import re
import shutil
import tomllib
import zipfile
from pathlib import Path
from random import Random

import numpy as np
import pandas as pd

from tests.support import ssp_texts as ssp
from tests.support.fmu_texts import FMI2, FMI3
from tests.support.fuzz_spoil import NUMBERS, WORDS, Tree, packed, spoil_bytes, spoil_xml, toml_file
from tests.support.paths import FMUS

COIL = FMUS / "Coil" / "Coil.fmu"


def samples() -> pd.DataFrame:
    """Return a record of the coil."""
    time = np.arange(40) * 1e-3
    return pd.DataFrame(
        {"time": time, "u": np.ones(40), "i": 0.25 * (1 - np.exp(-40 * time)) + 1e-3 * np.sin(9e4 * time)}
    )


STUDIES: list[Tree] = [*map(tomllib.loads, """
title = "A coil"
isolation = { time_limit = 60.0, memory_limit_mb = 4.0, max_simulations_per_process = 100 }
model = { fmu = "Coil.fmu", fixed = { L = 0.1 } }
experiments = [{ data = "run.csv", inputs = ["u"], outputs = ["i"], warmup = 0.002 }]
parameters = { R = { start = 3.0, min = 0.0, max = 10.0 } }
noise = { variance = "estimate" }
estimation = { method = "levenberg-marquardt", max_iterations = 20, jacobian = "finite-difference" }
---
model = { fmu = "Coil.fmu", interface = "model-exchange", solver = "rk45", tolerance = 1e-6 }
prior = { names = ["R", "L"], mean = [4.0, 0.1], covariance = [[1.0, 0.0], [0.0, 0.01]] }
noise = { variance = { i = 1e-6 } }
estimation = { loss = "huber", relative_step_tolerance = 1e-8, initial_trust_radius = 1.0, jacobian = "forward" }
uncertainty = { confidence_level = 0.95, profile_likelihood = ["R"], posterior = false, cost_map = [] }
[[experiments]]
name = "first"
data = "run.csv"
time = "time"
inputs = { u = "u" }
outputs = { i = "i" }
interpolation = { u = "zoh" }
units = { i = "A" }
[[experiments]]
data = "again.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "pchip"
[parameters]
R = { start = 3.0, prior = { mean = 4.0, std = 0.5 } }
L = { start = 0.2, min = 1e-3, nominal = 0.1 }
i_start = { start = 0.0, nominal = 0.1, per_experiment = true }
---
experiments = [{ data = "run.csv", inputs = { "a.u" = "u" }, outputs = { "a.i + b.i" = "i" } }]
parameters = { R = { start = 3.0 }, "b.L" = { start = 0.2 } }
noise = { variance = 1e-6, initial_variance = 0.1 }
estimation = { method = "multi-start", n_starts = 2, seed = 1, max_iterations = 3 }
prior = { result = "result.json", std_factor = 2.0, names = ["R"] }
[model]
components = [{ name = "a", fmu = "Coil.fmu", tolerance = 1e-6 }, { name = "b", fmu = "Coil.fmu" }]
connections = [{ from = "a.i", to = "b.u", factor = 10.0, offset = 0.1 }]
shared_variables = { R = ["a.R", "b.R"] }
coupling = "gauss-seidel"
step_size = 1e-3
""".split("---"))]  # fmt: skip  # noqa: SIM905
"""Studies with all words that do not take long."""
BATCHES: list[Tree] = [STUDIES[0] | each for each in map(tomllib.loads, """
model = { fmu = "Coil.fmu" }
parameters = { R = { start = 3.0, min = 0.0, max = 10.0 }, i_start = { start = 0.0, nominal = 0.1 } }
[batch]
combine = "product"
data = ["r*.csv", "again.csv"]
starting_points = [{ R = 2.0 }, { R = 5.0, i_start = 0.1 }]
free_parameters = [["R"], ["R", "i_start"]]
monte_carlo = { realizations = 3, std = { i = 1e-3 }, true_values = { R = 4.0 } }
seed = 1
sweep = { L = [0.05, 0.1] }
---
parameters = { R = { start = 3.0, prior = { mean = 4.0, std = 0.5 } }, i_start = { start = 0.0, nominal = 1.0 } }
noise = { variance = 1e-6 }
[batch]
starting_points = 3
monte_carlo = { realizations = 2 }
space_filling = { method = "sobol", points = 4, ranges = { i_start = [0.0, 0.1] } }
""".split("---"))]  # fmt: skip  # noqa: SIM905
"""Studies of many cases."""
TOO_LONG = re.compile(
    r"step_size|tolerance|starts|steps|walkers|burn|posterior|profile|map|max_iterations|method|search|count"
)
"""Words whose values decide how long a right answer takes."""
WITH_RESULT = STUDIES[2]
"""A study that takes its prior from a result."""


def may_take_long(given: Tree, raw: bytes) -> bool:
    """Whether a study may have other values than a good one has for the words that decide how long an answer takes."""
    text = raw.decode("utf-8", "replace")
    found = {word: sorted(re.findall(rf'"{word}" = ([^,}}]*)', text)) for word in TOO_LONG.pattern.split("|")}
    wanted = {word: sorted(re.findall(rf'"{word}" = ([^,}}]*)', toml_file(given).decode())) for word in found}
    return any(set(found[word]) - set(wanted[word]) for word in found)


def write_inputs(folder: Path, result: str) -> None:
    """Write all that the studies refer to, and an earlier result."""
    shutil.copy(COIL, folder / "Coil.fmu")
    for name in ("run.csv", "again.csv"):
        samples().to_csv(folder / name, index=False)
    (folder / "result.json").write_text(result)
    (folder / "study.toml").write_bytes(toml_file(STUDIES[0]))


def spoil_table(rng: Random, folder: Path) -> Path:
    """Write a table that is wrong in some way; tests of readers damage the other formats."""
    frame = samples().astype(object)
    for _ in range(rng.choice([0, 1, 1, 2, 4])):
        row, column = rng.randrange(len(frame)), rng.choice(list(frame.columns))
        frame.loc[row, column] = rng.choice([*WORDS, *NUMBERS, None, True])
    way = rng.randrange(8)
    if way == 0:
        frame = frame.iloc[: rng.choice([0, 1, 2, 3])]
    elif way == 1:
        frame = frame.sample(frac=rng.choice([1.0, 0.5]), random_state=rng.randrange(100))
    elif way == 2:
        frame = pd.concat([frame, frame.iloc[:: rng.choice([1, -1])]])
    elif way == 3:
        frame.columns = pd.Index(rng.choices([*frame.columns, *WORDS], k=3))
    text = frame.to_csv(index=rng.random() < 0.1, sep=rng.choice([*",,,,,;\t |"]))
    raw = text.encode(rng.choice(["utf-8"] * 5 + ["utf-16", "utf-8-sig"]), "replace")
    path = folder / "table.csv"
    path.write_bytes(spoil_bytes(rng, raw) if rng.random() < 0.5 else raw)
    return path


def fmu_files() -> dict[str, bytes]:
    """Return the files of the coil's FMU, without binaries: what is spoiled is not executed."""
    with zipfile.ZipFile(COIL) as archive:
        return {name: archive.read(name) for name in archive.namelist() if not name.startswith("binaries/")}


def spoil_fmu(rng: Random, path: Path) -> Path:
    """Write an FMU without binaries that is wrong in some way."""
    files = fmu_files()
    text = rng.choice([FMI2, FMI3, files["modelDescription.xml"].decode()])
    files["modelDescription.xml"] = spoil_xml(rng, text) if rng.random() < 0.7 else text.encode()
    if rng.random() < 0.2:
        files[rng.choice([word for word in WORDS if word.strip("\0")])] = b"x"
    raw = packed(files, rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))
    path.write_bytes(spoil_bytes(rng, raw) if rng.random() < 0.3 else raw)
    return path


def good_ssd(folder: Path) -> tuple[str, Path]:
    """Return the structure of a package and the package: all that SSP has and fmuid reads."""
    bound = ssp.binding(ssp.parameter("M", 96.0))
    ports = ssp.connector("qg", "input", "m") + ssp.connector("out", "output", "mm")
    body = ssp.content(
        ssp.drive(unit="m", bindings=bound) + ssp.controller(unit="mm"),
        ssp.LOOP + ssp.connection("qg", "controller.qg", ssp.linear(2)) + ssp.connection("drive.q", "out"),
    )
    path = ssp.pack(folder, body, ports, rest=ssp.LENGTHS, check=False)
    with zipfile.ZipFile(path) as archive:
        return archive.read("SystemStructure.ssd").decode(), path


def good_ssv() -> str:
    """Return parameter values."""
    return ssp.parameter_set(
        ssp.parameter("R", 4.5, unit="Ohm") + ssp.parameter("L", 0.2), ssp.LENGTHS.replace("ssd:", "ssv:"), _SPACES
    )


_SPACES = ' xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"'
