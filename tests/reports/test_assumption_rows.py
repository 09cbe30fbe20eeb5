"""What was assumed: values of the study and the run, and effects that the tests measured."""

import pytest

from fmuid import Study
from fmuid.reports.topics.assumption_rows import assumption_rows, guessed_keys
from fmuid.runs import identified
from tests.support.coil_study import STUDY, coil_table

GUESSED = STUDY.replace('= "zoh"', '= "zoh"  # guessed from constant stretches')


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, str]]:
    folder = tmp_path_factory.mktemp("assumed")
    coil_table(folder / "first.csv", 0.0, seed=1)
    path = folder / "study.toml"
    path.write_text(GUESSED.replace("[parameters]", "warmup = 0.01\nfixed = { i_start = 0.0 }\n[parameters]"))
    (found,) = identified(Study.read(path, isolated=False), folder / "results")
    return {name: (value, effect) for name, value, effect in assumption_rows(found)}


def test_assumptions_are_listed(rows: dict[str, tuple[str, str]]) -> None:
    assert rows["u between samples"][0] == "held, guessed"
    assert "the other moves" in rows["u between samples"][1]
    assert rows["warm-up"] == ("0.01 s", "simulated, not scored")
    assert rows["i_start"] == ("0.0", "fixed in this experiment")
    assert rows["time unit"][0] == "that of the data file, else s"
    assert rows["noise of i"][0].endswith("variance estimated")
    assert rows["solver"][0].startswith("FMI 2.0 Co-Simulation")
    assert rows["solver"][1].endswith("σ at most")
    assert "A of i moves" in rows["initial state"][1]
    assert "±½ sample" in rows["delay of outputs"][0]


def test_guesses_are_those_of_init() -> None:
    assert guessed_keys(GUESSED) == {"interpolation"}
    assert guessed_keys('a = 1  # free\ninputs = ["u"]  # guessed: u\n# guessed nothing = 2') == {"inputs"}
