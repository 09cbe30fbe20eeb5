"""Values to JSON and back: bit for bit, and one sentence for what does not fit."""

import json
import math
import struct
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from random import Random
from typing import Any, ClassVar

import jsonschema
import numpy as np
import pytest

import fmuid
from fmuid import Diagnosis, InputError, Result
from fmuid.apps.cli.app import run
from fmuid.array_types import Floats
from fmuid.codec import Layout, as_json, from_json, read, write
from fmuid.diagnosis import Alarm
from fmuid.estimation import RestartAttempt, SolverCheck, WeakDirection
from fmuid.files import ContentError
from fmuid.identification import Assessment
from fmuid.runs import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun
from fmuid.runs.result_schema import schema


class Color(Enum):
    """Something that is one of few."""

    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Inner:
    """Something inside.

    Attributes
    ----------
    text : str
        What it says.
    limit : float or None
    """

    text: str
    limit: float
    pair: tuple[int, bool]
    colors: tuple[Color, ...] = ()
    maybe: int | None = None
    value: float | int | bool | str = 0


@dataclass(frozen=True, eq=False)
class Outer:
    """Something with rows by name."""

    names: tuple[str, ...]
    values: Floats
    matrix: Floats
    units: dict[str, str]
    inner: Inner
    many: dict[str, Inner]
    path: Path
    left_out: object = field(default=None, repr=False)

    json_layout: ClassVar = Layout(
        omitted={"left_out"},
        derived=("total",),
        rows={"rows": {"value": "values", "unit": "units"}},
        parts={"whole": {"names": "names", "matrix": "matrix"}},
    )

    @property
    def total(self) -> int:
        """Number of values."""
        return self.values.size


SPECIAL = (0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, 1.7976931348623157e308, 0.1)
RANGES = ((0, 0x20), (0x20, 0x7F), (0x7F, 0xD800), (0xE000, 0x110000))  # control, ASCII, others but for surrogates


def number(rng: Random) -> float:
    """Return any float: half of them special ones."""
    found: float = struct.unpack("d", rng.randbytes(8))[0]
    return rng.choice((found, rng.choice(SPECIAL)))


def text(rng: Random) -> str:
    return "".join(chr(rng.randrange(*rng.choice(RANGES))) for _ in range(rng.randrange(6)))


def inner(rng: Random) -> Inner:
    whole, finite = rng.randrange(-(2**70), 2**70), rng.uniform(-1e9, 1e9)
    colors = tuple(rng.choices(tuple(Color), k=rng.randrange(4)))
    value = rng.choice((whole, finite, rng.random() < 0.5, text(rng)))
    return Inner(text(rng), number(rng), (whole, rng.random() < 0.5), colors, rng.choice((None, whole)), value)


def outer(seed: int) -> Outer:
    """Return drawn content."""
    rng = Random(seed)
    names = tuple(dict.fromkeys(text(rng) for _ in range(rng.randint(1, 3))))
    count = len(names)
    values = np.array([number(rng) for _ in range(count)])
    matrix = np.array([number(rng) for _ in range(count**2)]).reshape(count, count)
    units = {name: text(rng) for name in names if rng.random() < 0.5}
    many = {text(rng): inner(rng) for _ in range(rng.randrange(4))}
    return Outer(names, values, matrix, units, inner(rng), many, Path("a/b"))


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal to the last bit, and of the same types; one NaN is as good as another."""
    if isinstance(one, float):
        return type(other) is float and (repr(one) == repr(other))
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other, equal_nan=True)) and one.dtype == other.dtype
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)
    return type(one) is type(other) and bool(one == other)


def test_a_value_comes_back_to_the_last_bit() -> None:
    for value in map(outer, range(200)):
        written = json.dumps(as_json(value), allow_nan=False)
        assert same(from_json(Outer, json.loads(written)), value)


def spoilt(content: Any, way: list[int]) -> Any:
    """Return a content with something else at the end of a way into it."""
    if isinstance(content, dict) and content and way:
        key = sorted(content)[way[0] % len(content)]
        return {**content, key: spoilt(content[key], way[1:])}
    if isinstance(content, list) and content and way:
        k = way[0] % len(content)
        return [*content[:k], spoilt(content[k], way[1:]), *content[k + 1 :]]
    return ["of old", {"x": 1e400}, None, [[]], -1, "inf"][len(way) % 6]


def test_what_does_not_fit_is_told_or_read() -> None:
    for seed in range(200):
        rng = Random(seed)
        way = [rng.randrange(10) for _ in range(rng.randrange(7))]
        try:
            found = from_json(Outer, spoilt(as_json(outer(seed)), way))
        except ContentError as error:
            assert "\n" not in str(error)
        else:
            assert isinstance(found, Outer)


def test_files_say_their_schema(tmp_path: Path) -> None:
    inner = Inner("a", math.inf, (1, True))
    path = write(tmp_path / "one.json", "test/1", inner)
    assert json.loads(path.read_text()) == {"schema": "test/1", **as_json(inner)}
    assert read(path, "test/1", Inner, "write it again") == inner
    with pytest.raises(InputError, match=r"one\.json is of schema 'test/1', not 'test/2': write it again"):
        read(path, "test/2", Inner, "write it again")
    path.write_text('{"schema": "test/1", "text": 3}')
    with pytest.raises(InputError, match=r"cannot be right: text: the value should be a text, not 3; write it again"):
        read(path, "test/1", Inner, "write it again")
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"one\.json is not JSON"):
        read(path, "test/1", Inner, "write it again")


def test_the_schema_describes_the_fields() -> None:
    found = schema(Outer, "test/1")
    own, inner = found["$defs"]["Outer"], found["$defs"]["Inner"]
    assert own["properties"]["schema"] == {"const": "test/1"}
    assert {"rows", "whole", "inner", "total"} <= own["properties"].keys()
    assert "left_out" not in own["properties"]
    assert inner["properties"]["text"] == {"type": "string", "description": "What it says."}
    assert inner["description"] == "Something inside."
    assert "colors" not in inner["required"]


FILES = (Result, IdentificationRun, DiagnosisRun, MonitoringRun, PredictionRun, ComparisonRun)


@pytest.mark.parametrize("kind", [*FILES, Diagnosis, Assessment, Alarm, RestartAttempt, SolverCheck, WeakDirection])
def test_every_file_has_a_schema(kind: type) -> None:
    found = schema(kind, "test/1")
    json.dumps(found, allow_nan=False)
    assert found["$defs"][kind.__name__]["properties"]


def test_the_command_prints_the_schema_of_a_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a run writes is as the schema says."""
    monkeypatch.chdir(tmp_path)
    assert run(["schema", "result"]) == 0
    validator = jsonschema.Draft202012Validator(json.loads(capsys.readouterr().out))
    validator.check_schema(validator.schema)
    fmuid.run(fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml"), "results", report=False)
    content = json.loads((tmp_path / "results/result.json").read_text())
    validator.validate(content)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(content | {"outcome": "well"})
    assert run(["schema", "batch"]) == 2
