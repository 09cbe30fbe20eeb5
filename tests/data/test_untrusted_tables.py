"""Data files execute nothing: pickles, formulas and extension types in them are read as values, or refused."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fmuid import InputError, read_data
from fmuid.data.readers.pandas_hdf import PickledObject, plain_value

ROWS = 6
DATES = pd.date_range("2026-03-01 10:00", periods=ROWS, freq="100ms")
FRAME = pd.DataFrame({"time": 0.1 * np.arange(ROWS), "u": 1.5 * np.arange(ROWS), "n": np.arange(ROWS)})
TEXTS: Any = [*"abcde", None]
PATHS: Any = [Path("a")] * ROWS
LONG = FRAME.assign(
    on=[True, False] * (ROWS // 2),
    state=TEXTS,
    begun=DATES,
    local=DATES.tz_localize("UTC").tz_convert("Europe/Berlin"),
    lasted=pd.to_timedelta(np.arange(ROWS), unit="s"),
)


class Payload:
    """Runs a command when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.mark}",)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_value_reads_plain_pickles(protocol: int) -> None:
    value = [1, (0, "index"), {"tz": None, "names": ["ü", True]}, 1.5, 2**70, -3, [], (), (1, 2, 3, 4)]
    assert plain_value(pickle.dumps(value, protocol)) == value


def test_plain_value_builds_no_object(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    found = plain_value(pickle.dumps([Payload(mark)]))
    assert isinstance(found[0], PickledObject)
    assert found[0].arguments == (f"touch {mark}",)
    assert not mark.exists()


@pytest.mark.parametrize(
    "data", [b"", b".", b"R.", b"(.", b"(lp0\ng7\na.", b"\x80\x05K\x01", b"]K\x01u.", b"\x82\x01."]
)
def test_plain_value_refuses_other_bytes(data: bytes) -> None:
    with pytest.raises(ValueError):
        plain_value(data)


@pytest.mark.parametrize("index", ["rows", "named", "dates", "dates of a town", "durations", "texts"])
@pytest.mark.parametrize(("layout", "by_column"), [("fixed", None), ("table", True)])
def test_hdf_tables_of_pandas(tmp_path: Path, layout: Any, by_column: Any, index: str) -> None:
    """Compare with `pandas.read_hdf`."""
    frames = {
        "rows": LONG,
        "named": LONG.drop(columns="time").set_index(pd.Index(LONG["time"], name="time")),
        "dates": LONG.drop(columns="time").set_index(pd.DatetimeIndex(DATES)),
        "dates of a town": LONG.drop(columns="time").set_index(
            pd.DatetimeIndex(DATES.tz_localize("Europe/Berlin"), name="time")
        ),
        "durations": LONG.drop(columns="time").set_index(pd.TimedeltaIndex(LONG["lasted"], name="time")),
        "texts": LONG.set_index(pd.Index([*"uvwxyz"], name="part")),
    }
    frame, path = frames[index], tmp_path / "run.h5"
    frame.to_hdf(path, key="bench/run", format=layout, data_columns=by_column)
    found = read_data(path)
    expected = pd.read_hdf(path)
    assert isinstance(expected, pd.DataFrame)
    times = LONG["lasted"].dt.total_seconds() if index == "durations" else LONG["time"]
    np.testing.assert_allclose(found["time"], times, atol=1e-12)
    if index == "texts":
        assert [*found["part"]] == [*"uvwxyz"]
    for name in expected.columns.difference(["time", "on", "state"]):
        assert [*found[name]] == [*expected[name]], name
    np.testing.assert_array_equal(found["on"].astype(int), expected["on"].astype(int))
    assert [*found["state"]][:5] == [*"abcde"]


def test_hdf_tables_of_pandas_with_other_headers(tmp_path: Path) -> None:
    FRAME.rename(columns={"u": "Größe [mV]"}).to_hdf(tmp_path / "a.h5", key="run")
    assert read_data(tmp_path / "a.h5").attrs["units"] == {"Größe": "mV"}
    FRAME.set_axis(range(3), axis="columns").to_hdf(tmp_path / "a.h5", key="run", mode="w")
    assert [*read_data(tmp_path / "a.h5", "0")] == ["0", "1", "2"]
    FRAME[:0].to_hdf(tmp_path / "b.h5", key="run")
    with pytest.raises(InputError, match=r"b\.h5: no samples below the header"):
        read_data(tmp_path / "b.h5")


def test_hdf_with_several_tables_of_pandas(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    FRAME.to_hdf(path, key="bench/cold")
    (FRAME + 1.0).to_hdf(path, key="warm")
    with pytest.raises(InputError, match=r"a\.h5: several frames: bench/cold, warm"):
        read_data(path)
    for sheet, first in (("bench/cold", 0.0), ("warm", 1.0), (2, 1.0)):
        assert read_data(path, sheet=sheet)["u"][0] == first
    with pytest.raises(InputError, match=r"no sheet 'warn' \(did you mean 'warm'\?\)\. Choose one of bench/cold"):
        read_data(path, sheet="warn")


LEVELS = pd.MultiIndex.from_product([["a", "b"], [1, 2, 3]], names=["p", "q"])
REFUSED: dict[str, tuple[Any, Any]] = {
    "is no frame": (FRAME["u"], "fixed"),
    "its index in '/run' has levels": (FRAME.set_index(LEVELS), "fixed"),
    "its index in '.run' has levels": (FRAME.set_index(LEVELS), "table"),
    "its header in '/run' has levels": (FRAME.T.set_axis(LEVELS[:3]).T, "fixed"),
    "its header in '/run' has labels of the type object": (FRAME.set_axis(["time", 1, 2], axis="columns"), "fixed"),
    "'kind' in '/run' has categories": (FRAME.assign(kind=pd.Categorical([*"ababab"])), "table"),
    "'kind' in '/run' has Python objects": (FRAME.assign(kind=PATHS), "fixed"),
}


@pytest.mark.parametrize("sentence", REFUSED)
@pytest.mark.filterwarnings("ignore")
def test_hdf_tables_of_pandas_that_are_refused(tmp_path: Path, sentence: str) -> None:
    frame, layout = REFUSED[sentence]
    frame.to_hdf(tmp_path / "run.h5", key="run", format=layout)
    with pytest.raises(InputError, match=sentence) as caught:
        read_data(tmp_path / "run.h5")
    assert str(caught.value).startswith(f"{tmp_path / 'run.h5'}: ")


def test_hdf_headers_that_are_objects(tmp_path: Path) -> None:
    FRAME.to_hdf(tmp_path / "run.h5", key="run")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["run/axis0"].attrs["kind"] = np.bytes_(pickle.dumps(Payload(tmp_path / "mark"), 0))
    with pytest.raises(InputError, match="its header in '/run' has Python objects"):
        read_data(tmp_path / "run.h5")


def test_hdf_tables_of_pandas_by_a_compressor_that_is_missing(tmp_path: Path) -> None:
    FRAME.to_hdf(tmp_path / "run.h5", key="run", format="table", complevel=1, complib="blosc")
    with pytest.raises(InputError, match=r"run\.h5: 'run/table' is compressed by blosc.*Save it with zlib"):
        read_data(tmp_path / "run.h5")


def places(path: Path) -> list[tuple[str, str | None]]:
    """Return the paths of groups and datasets with the names of their attributes, and without for pickled arrays."""
    found: list[tuple[str, str | None]] = []
    with h5py.File(path) as file:
        found += [("/", name) for name in file.attrs]

        def look(name: str, item: Any) -> None:
            if "_i_table" in name:
                return
            found.extend((name, each) for each in item.attrs)
            if item.attrs.get("PSEUDOATOM") == b"object":
                found.append((name, None))

        file.visititems(look)
    return found


@pytest.mark.parametrize("layout", [pytest.param("fixed", marks=pytest.mark.slow), "table"])
def test_hdf_executes_no_pickle_anywhere(tmp_path: Path, layout: Any) -> None:
    """One file for each attribute and pickled array that PyTables would unpickle."""
    sound, mark = tmp_path / "sound.h5", tmp_path / "mark"
    frame = LONG.set_index(pd.DatetimeIndex(DATES.tz_localize("UTC"), name="clock"))
    frame.to_hdf(sound, key="run", format=layout)
    data = pickle.dumps(Payload(mark), 0)
    outcomes = set()
    for number, (name, attribute) in enumerate(places(sound)):
        path = tmp_path / f"{number}.h5"
        path.write_bytes(sound.read_bytes())
        with h5py.File(path, "r+") as file:
            if attribute is None:
                file[name][0] = np.frombuffer(data, np.uint8)
            else:
                file[name].attrs[attribute] = np.bytes_(data)
        try:
            outcomes.add(len(read_data(path)))
        except InputError as error:
            assert str(error).startswith(f"{path}: "), error
            outcomes.add(-1)
        assert not mark.exists(), (name, attribute)
    assert outcomes == {-1, ROWS}


@pytest.mark.parametrize("suffix", [".mf4", ".mdf"])
def test_mdf_formulas_are_expressions(tmp_path: Path, suffix: str) -> None:
    """Numexpr's check of a formula does not see an attribute behind a continued line."""
    from asammdf import MDF, Signal

    mark, path, times = tmp_path / "mark", tmp_path / f"run{suffix}", 0.1 * np.arange(ROWS)
    deep = "(i for i in (1,)).\\\ngi_frame.\\\nf_builtins.\\\nget('eval')"
    formulas = {
        "2 * X + 1": None,
        f'X + {deep}(\'__import__("os").system("touch {mark}")\')': "the formula",
        "X +": "X",
    }
    for formula, sentence in formulas.items():
        with MDF(version="4.10" if suffix == ".mf4" else "3.30") as file:
            file.append([Signal(np.arange(ROWS), times, name="u", conversion={"formula": formula})])
            file.save(path, overwrite=True)
        if sentence is None:
            np.testing.assert_allclose(read_data(path)["u"], 2.0 * np.arange(ROWS) + 1)
            continue
        with pytest.raises(InputError, match=r"conversion formula .*cannot be computed"):
            read_data(path)
        assert not mark.exists()


def test_parquet_unpickles_no_extension_type(tmp_path: Path) -> None:
    mark, path = tmp_path / "mark", tmp_path / "run.parquet"
    said = {"ARROW:extension:name": "arrow.py_extension_type", "ARROW:extension:metadata": pickle.dumps(Payload(mark))}
    schema = pa.schema([pa.field("time", pa.float64()), pa.field("u", pa.float64(), metadata=said)])
    pq.write_table(pa.table({"time": FRAME["time"], "u": FRAME["u"]}, schema=schema), path)
    np.testing.assert_array_equal(read_data(path)["u"], FRAME["u"])
    assert not mark.exists()


ARROW: dict[str, Callable[[], Any]] = {
    "days": lambda: pa.array([19000, 19001], pa.date32()),
    "clock": lambda: pa.array([3_600_000, 3_600_100], pa.time32("ms")),
    "decimal": lambda: pa.array([1.0, 2.0]).cast(pa.decimal128(9, 2)),
    "dictionary": lambda: pa.array(["a", "b"]).dictionary_encode(),
    "missing": lambda: pa.array([True, None]),
    "list": lambda: pa.array([[1.0], [2.0, 3.0]]),
    "nothing": lambda: pa.nulls(2),
}


def test_parquet_columns_of_other_types(tmp_path: Path) -> None:
    columns = {name: make() for name, make in ARROW.items()}
    pq.write_table(pa.table({"time": [0.0, 1.0], **columns}), tmp_path / "a.parquet")
    found = read_data(tmp_path / "a.parquet")
    assert [*found] == ["time", *ARROW]
    assert [*found["clock"]] == ["01:00:00", "01:00:00.100000"]
    np.testing.assert_array_equal(found["decimal"], [1.0, 2.0])
    np.testing.assert_array_equal(found["missing"], [1.0, np.nan])
    assert [*found["dictionary"]] == ["a", "b"]
    assert found["list"][0] == "list<element: double>"
    assert found["nothing"].isna().all()
    assert read_data(tmp_path / "a.parquet", "days")["days"][1] == 86400.0


def test_parquet_numbers_with_missing_samples_in_several_groups(tmp_path: Path) -> None:
    """Compare with pandas."""
    rng = np.random.default_rng(1)
    frame = pd.DataFrame({"time": np.arange(20.0)})
    for name, kind in (("i", "Int16"), ("u", "UInt8"), ("f", "Float32"), ("b", "boolean")):
        frame[name] = pd.array(rng.integers(0, 2, 20), dtype=kind)  # type: ignore[call-overload]
        frame.loc[rng.integers(0, 20, 3), name] = None
    frame["date"] = DATES[0] + pd.to_timedelta(frame["time"].where(frame["time"] != 7), unit="s")
    pq.write_table(pa.Table.from_pandas(frame), tmp_path / "a.parquet", row_group_size=6)
    found = read_data(tmp_path / "a.parquet")
    for name in "iufb":
        np.testing.assert_array_equal(found[name].astype(float), frame[name].to_numpy(float, na_value=np.nan))
    pd.testing.assert_series_equal(found["date"], frame["date"], check_dtype=False)
