"""The same measurements written in sixty ways: each is read as the same numbers, or refused in one sentence."""

from __future__ import annotations

import gzip
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from fmuid.data import Experiment, read_table
from fmuid.errors import InputError

T = np.arange(12) * 0.01
U = np.where(T < 0.05, 2.0, -1.0)
W = 30.0 * (1 - np.exp(-T / 0.03))
RPM = W * 30 / np.pi
FRAME = pd.DataFrame({"time": T, "u": U, "w": W})


def cells(frame: pd.DataFrame, separator: str = ",", decimal: str = ".") -> list[str]:
    return [separator.join(repr(float(value)).replace(".", decimal) for value in row) for row in frame.to_numpy()]


def text(header: str, separator: str = ",", decimal: str = ".", frame: pd.DataFrame = FRAME, above: str = "") -> str:
    return above + "\n".join([header, *cells(frame, separator, decimal)]) + "\n"


MS = FRAME.assign(time=1000 * T)
WITH_RPM = FRAME.assign(w=RPM)
DATES = pd.Timestamp("2026-11-02T10:30:00") + pd.to_timedelta(T, unit="s")
DATED = "time,u,w\n" + "".join(
    f"{date.isoformat(timespec='microseconds')},{u!r},{w!r}\n"
    for date, u, w in zip(DATES, U.tolist(), W.tolist(), strict=True)
)

TEXTS: dict[str, tuple[str, str | bytes]] = {
    "plain": ("a.csv", text("time,u,w")),
    "txt": ("a.txt", text("time,u,w")),
    "tsv": ("a.tsv", text("time\tu\tw", "\t")),
    "dat with spaces": ("a.dat", text("time u w", "  ")),
    "tabs": ("a.csv", text("time\tu\tw", "\t")),
    "tabs and commas": ("a.txt", text("time\tu\tw", "\t", ",")),
    "bars": ("a.csv", text("time|u|w", "|")),
    "semicolons": ("a.csv", text("time;u;w", ";")),
    "German": ("a.csv", text("time;u;w", ";", ",")),
    "German with mark": ("a.csv", text("time;u;w", ";", ",").encode("utf-8-sig")),
    "German of Windows": ("a.csv", text("time;u;w;Größe", ";", ",", FRAME.assign(x=1.0)).encode("cp1252")),
    "UTF-16": ("a.csv", text("time\tu\tw", "\t", ",").encode("utf-16")),
    "quoted commas": ("a.csv", text('time","u","w', '","', ",").replace("\n", '"\n"').join(('"', ""))[:-1]),
    "quoted": ("a.csv", text('"time","u","w"')),
    "carriage returns": ("a.csv", text("time,u,w").replace("\n", "\r\n")),
    "ends with separators": ("a.csv", text("time;u;w;", ";").replace("\n", ";\n").replace(";;", ";")),
    "spaces after commas": ("a.csv", text("time, u, w", ", ")),
    "comment lines": ("a.csv", text("time,u,w", above="# rig 4\n# rate: 100 Hz, gain 3\n")),
    "commented header": ("a.csv", text("# time,u,w")),
    "commented header, spaces": ("a.txt", text("# time u w", " ")),
    "percent": ("a.csv", text("time,u,w", above="% of the rig\n")),
    "semicolon comments": ("a.csv", text("time;u;w", ";", above="; of the rig\n; 2026\n")),
    "preamble": ("a.csv", text("time;u;w", ";", ",", above="Rig;4\nRate;100\n\nOperator;A;B\n")),
    "preamble of numbers": ("a.csv", text("time,u,w", above="Recorder,X,Y\n1,2,3\nName,a,b\n")),
    "unit row": ("a.csv", text("time,u,w\ns,V,rad/s")),
    "unit row, ms, rpm": ("a.csv", text("time;u;w\nms;V;rpm", ";", ",", MS.assign(w=RPM))),
    "unit row in brackets": ("a.csv", text("time,u,w\n[ms],[V],[1/min]", frame=MS.assign(w=RPM))),
    "names, units, words": ("a.csv", text("time,u,w\ns,V,rad/s\nclock,supply,shaft")),
    "time [s]": ("a.csv", text("time [s],u [V],w [rad/s]")),
    "Time (ms)": ("a.csv", text("Time (ms),u,w", frame=MS)),
    "time_ms": ("a.csv", text("time_ms,u,w", frame=MS)),
    "t": ("a.csv", text("t,u,w")),
    "T": ("a.csv", text("T,u,w")),
    "T beside Zeit": ("a.csv", text("T;Zeit;u;w", ";", frame=FRAME.assign(T=20.0)[["T", "time", "u", "w"]])),
    "T in degrees": ("a.csv", text("Zeit;u;w;T [°C]", ";", frame=FRAME.assign(T=20.0))),
    "Zeit in ms": ("a.csv", text("Zeit [ms];u;w", ";", ",", MS).encode("cp1252")),
    "µs": ("a.csv", text("Time (µs),u,w", frame=FRAME.assign(time=1e6 * T))),
    "min": ("a.csv", text("time [min],u,w", frame=FRAME.assign(time=T / 60))),
    "w (rpm)": ("a.csv", text("time,u,w (rpm)", frame=WITH_RPM)),
    "w[n/min]": ("a.csv", text("time,u,w[n/min]", frame=WITH_RPM)),
    "u (mV)": ("a.csv", text("time,u (mV),w", frame=FRAME.assign(u=1000 * U))),
    "u in kV": ("a.csv", text("time,u [kV],w", frame=FRAME.assign(u=U / 1000))),
    "dates": ("a.csv", DATED),
    "dates with zone": ("a.csv", DATED.replace("000,", "000+01:00,")),
    "dates of Germany": ("a.csv", DATED.replace("2026-11-02T", "22.11.2026 ")),
    "times of the day": ("a.csv", DATED.replace("2026-11-02T", "")),
    "other order": ("a.csv", text("w,time,u", frame=FRAME[["w", "time", "u"]])),
    "more columns": ("a.csv", text("time,x,u,w,y", frame=FRAME.assign(x=1.0, y=2.0)[["time", "x", "u", "w", "y"]])),
    "exponents": ("a.csv", "time,u,w\n" + "\n".join(f"{t:.17E},{u:.17E},{w:.17E}" for t, u, w in FRAME.to_numpy())),
}  # fmt: skip


def experiment(path: Path) -> Experiment:
    return Experiment(read_table(path), ["u"], ["w"])


def check(found: Experiment) -> None:
    """Compare with what was written, in the units in which it is said to be."""
    factor = {
        "rpm": np.pi / 30,
        "1/min": np.pi / 30,
        "n/min": np.pi / 30,
        "rad/s": 1.0,
        None: 1.0,
        "V": 1.0,
        "mV": 1e-3,
        "kV": 1e3,
    }
    np.testing.assert_allclose(found.times, T, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.input_values[:, 0] * factor[found.units.get("u")], U, rtol=1e-9)
    np.testing.assert_allclose(found.output_values[:, 0] * factor[found.units.get("w")], W, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("variant", TEXTS)
def test_texts(tmp_path: Path, variant: str) -> None:
    name, content = TEXTS[variant]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    check(experiment(path))


def write_gzip(path: Path) -> None:
    path.write_bytes(gzip.compress(text("time,u,w").encode()))


def write_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", text("time;u;w", ";", ","))


def write_sheet(path: Path) -> None:
    with pd.ExcelWriter(path, engine="odf" if path.suffix == ".ods" else "openpyxl") as book:
        pd.DataFrame({"about": ["the rig"]}).to_excel(book, sheet_name="about", index=False)
        MS.rename(columns={"time": "Time (ms)"}).to_excel(book, sheet_name="run", startrow=3, startcol=1, index=False)


def write_hdf(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        for name, values, unit in (("time", 1000 * T, "ms"), ("u", U, "V"), ("w", RPM, "rpm")):
            group[name] = values
            group[name].attrs["unit"] = unit


def write_compound(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run"] = FRAME.to_records(index=False)


def write_mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("run")
        for name, values in (("time", T), ("u", U), ("w", W)):
            group[name] = values[np.newaxis, :]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_tdms(path: Path) -> None:
    waveform = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    with TdmsWriter(path) as writer:
        writer.write_segment([
            ChannelObject("run", "u", U, properties=waveform | {"unit_string": "V"}),
            ChannelObject("run", "w", RPM, properties=waveform | {"unit_string": "rpm"}),
        ])  # fmt: skip


def write_mdf(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(U, T, name="u", unit="V"), Signal(RPM, T, name="w", unit="rpm")])
        file.save(path)


FILES: dict[str, Callable[[Path], object]] = {
    "a.csv.gz": write_gzip,
    "a.zip": write_zip,
    "a.csv.zip": write_zip,
    "a.xlsx": write_sheet,
    "a.ods": write_sheet,
    "a.parquet": FRAME.to_parquet,
    "index.parquet": FRAME.set_index("time").to_parquet,
    "dates.parquet": FRAME.assign(time=DATES).to_parquet,
    "dated-index.parquet": FRAME[["u", "w"]].set_index(DATES).to_parquet,
    "durations.parquet": FRAME.assign(time=pd.to_timedelta(T, unit="s")).to_parquet,
    "a.feather": FRAME.to_feather,
    "a.json": lambda path: FRAME.to_json(path, orient="records", double_precision=15),
    "a.h5": write_hdf,
    "compound.h5": write_compound,
    "fixed.h5": lambda path: FRAME.to_hdf(path, key="run"),
    "table.h5": lambda path: FRAME.to_hdf(path, key="run", format="table"),
    "vectors.mat": lambda path: savemat(path, {"time": T, "u": U, "w": W}),
    "structure.mat": lambda path: savemat(path, {"run": {"time": T, "u": U, "w": W, "rig": "4"}}),
    "matrix.mat": lambda path: savemat(path, {"data": FRAME.to_numpy(), "names": np.array([*FRAME], dtype=object)}),
    "v73.mat": write_mat73,
    "a.tdms": write_tdms,
    "a.mf4": write_mdf,
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_files(tmp_path: Path, name: str) -> None:
    FILES[name](tmp_path / name)
    check(experiment(tmp_path / name))


def test_there_are_sixty_variants() -> None:
    assert len(TEXTS) + len(FILES) >= 60


def test_missing_samples_by_a_dash(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time;u;w\n0;1,5;-\n1;2,5;3\n2;2,5; - \n")
    found = experiment(path)
    np.testing.assert_array_equal(found.output_values[:, 0], [np.nan, 3, np.nan])


def test_shuffled_rows_are_refused_with_their_row(tmp_path: Path) -> None:
    FRAME.iloc[[0, 2, 1, *range(3, 12)]].to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match="the time column 'time' decreases in row 3"):
        experiment(tmp_path / "a.csv")


def test_no_times_but_a_rate(tmp_path: Path) -> None:
    FRAME[["u", "w"]].to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=r"the time column 'time' is missing \(there is u, w\)"):
        read_table(tmp_path / "a.csv")
    check(Experiment.read(tmp_path / "a.csv", ["u"], ["w"], sample_rate=100.0))
    FRAME.to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(InputError, match="there are a column 'time' and a sample rate"):
        read_table(tmp_path / "b.csv", sample_rate=100.0)


def test_the_time_by_its_place_and_in_a_unit_that_is_given(tmp_path: Path) -> None:
    MS.rename(columns={"time": "clock"}).to_csv(tmp_path / "a.csv", index=False)
    check(Experiment(read_table(tmp_path / "a.csv", 1, time_unit="ms"), ["u"], ["w"]))
    with pytest.raises(InputError, match=r"there is no column 4: the table has 3"):
        read_table(tmp_path / "a.csv", 4)
    with pytest.raises(InputError, match="the unit of time 'fortnight' is not known: write one of s, ms"):
        read_table(tmp_path / "a.csv", 1, time_unit="fortnight")


def test_columns_may_be_named_with_the_units_of_their_headers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text("Time (ms),u (mV),shaft (rpm)", frame=MS.assign(u=1000 * U, w=RPM)))
    frame = read_table(tmp_path / "a.csv", "Time (ms)")
    assert frame.attrs["units"] == {"u": "mV", "shaft": "rpm"}
    check(Experiment(frame, {"u": "u (mV)"}, {"w": "shaft (rpm)"}, "Time (ms)"))


def test_the_date_of_the_first_sample_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TEXTS["dates with zone"][1])  # type: ignore[arg-type]
    begin = read_table(tmp_path / "a.csv").attrs["begin"]
    assert begin.isoformat() == "2026-11-02T10:30:00+01:00"


@pytest.mark.parametrize(
    ("module", "name", "extra"),
    [
        ("python_calamine", "a.xlsx", "excel"),
        ("h5py", "a.h5", "hdf"),
        ("nptdms", "a.tdms", "tdms"),
        ("asammdf", "a.mf4", "mdf"),
    ],
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, name: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match=rf'read by {module}, which is not installed: pip install "fmuid\[{extra}\]"'):
        read_table(tmp_path / name)


@pytest.mark.parametrize("kind", ["cut gzip", "spoilt gzip", "cut zip", "spoilt zip", "encrypted zip", "two in a zip"])
def test_what_cannot_be_unpacked(tmp_path: Path, kind: str) -> None:
    """Also beyond the part of the file in which its layout is looked for."""
    content = ("time,u,w\n" + "".join(f"{k},{k * 7919 % 10007},{k * k % 10007}\n" for k in range(40000))).encode()
    path = tmp_path / ("a.csv.gz" if "gzip" in kind else "a.zip")
    write_long(path, content, 2 if "two" in kind else 1)
    packed = bytearray(path.read_bytes())
    if "cut" in kind:
        packed = packed[:-200]
    elif "spoilt" in kind:
        packed[len(packed) // 2] ^= 0xFF
    elif "encrypted" in kind:  # says the flag in both headers
        packed[6] |= 1
        packed[packed.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(packed)
    with pytest.raises(
        InputError, match=r"cannot be unpacked: pack it again|holds 2 files: give one with the table alone"
    ):
        read_table(path)


def write_long(path: Path, content: bytes, files: int) -> None:
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(content))
        return
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(files):
            archive.writestr(f"{number}.csv", content)


def test_a_sheet_by_name_and_by_place(tmp_path: Path) -> None:
    path = tmp_path / "a.xlsx"
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        FRAME.assign(u=0.0).to_excel(book, sheet_name="idle", index=False)
        FRAME.to_excel(book, sheet_name="run", index=False)
        pd.DataFrame({"remark": ["none"]}).to_excel(book, sheet_name="about", index=False)
    assert not read_table(path)["u"].any()
    given: tuple[str | int, ...] = ("run", 2)
    for sheet in given:
        pd.testing.assert_frame_equal(read_table(path, sheet=sheet)[["time", "u", "w"]], FRAME)
    wrong: dict[str | int, str] = {
        "rum": "there is no sheet 'rum'.*'run'.*the file has idle, run, about",
        4: "there is no sheet 4: the file has idle, run, about",
        "about": "the sheet 'about' does not hold a table",
    }
    for other, sentence in wrong.items():
        with pytest.raises(InputError, match=sentence):
            read_table(path, sheet=other)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("a.xlsx", "the file is no readable spreadsheet"),
        ("a.h5", "the file is no readable HDF5 file"),
        ("a.tdms", "the file is no readable TDMS file|has no channels with samples"),
        ("a.mf4", "the file is no readable MDF file"),
        ("a.feather", "the file is no readable Feather table"),
        ("a.json", "the file is no readable JSON table"),
    ],
)
def test_files_that_are_none(tmp_path: Path, name: str, sentence: str) -> None:
    for broken in (b"", b"hello world", bytes(range(256)) * 4):
        (tmp_path / name).write_bytes(broken)
        with pytest.raises(InputError, match=sentence):
            read_table(tmp_path / name)
