"""One record of a motor as test benches, loggers, spreadsheets and simulators write it."""

import gzip
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat
from scipy.linalg import expm

from tests.support import bench_texts, historian_texts, instrument_texts, logger_texts, simulator_texts
from tests.support.mat4 import characters, write_mat4

MODEL = """
model Motor "permanent-magnet motor without inductance"
  parameter Real R(unit="Ohm") = 1.0 "armature resistance";
  parameter Real k(unit="N.m/A") = 0.05 "motor constant";
  parameter Real J(unit="kg.m2") = 2e-4 "inertia";
  parameter Real b(unit="N.m.s/rad") = 1e-4 "viscous friction";
  input Real u(unit="V");
  output Real i(unit="A");
  output Real w(unit="rad/s", start=0, fixed=true);
equation
  R*i = u - k*w;
  J*der(w) = k*i - b*w;
end Motor;
"""
TRUTH = {"R": 1.7, "k": 0.08, "J": 1.2e-4, "b": 3e-4}
ROWS = 120
RPM = 30 / np.pi


def record() -> pd.DataFrame:
    """Return time (s), u (V), i (A), w (rad/s): exact from sample to sample where u holds, with noise."""
    resistance, constant, inertia, friction = TRUTH.values()
    rng = np.random.default_rng(8)
    u = np.repeat(rng.integers(-12, 13, ROWS // 6 + 1), 6)[:ROWS] * 1.0
    rate, gain = -(constant**2 / resistance + friction) / inertia, constant / resistance / inertia
    step = expm(0.01 * np.array([[rate, gain], [0.0, 0.0]]))
    w = np.zeros(ROWS)
    for k in range(1, ROWS):
        w[k] = step[0] @ [w[k - 1], u[k - 1]]
    i = (u - constant * w) / resistance
    noisy = [values + 0.01 * values.std() * rng.standard_normal(ROWS) for values in (i, w)]
    return pd.DataFrame({"time": np.arange(ROWS) / 100, "u": u, "i": noisy[0], "w": noisy[1]})


FRAME = record()
MS = FRAME.assign(time=np.arange(ROWS) * 10.0)
IN_RPM = FRAME.assign(w=FRAME["w"] * RPM)
IN_MA = FRAME.assign(i=FRAME["i"] * 1000)
BEGIN = pd.Timestamp("2026-11-22T10:30:00")
DATES = BEGIN + pd.to_timedelta(MS["time"], unit="ms")


def cells(frame: pd.DataFrame, separator: str = ",", decimal: str = ".") -> list[str]:
    rows = frame.astype(object).to_numpy()
    return [
        separator.join(cell if isinstance(cell, str) else repr(float(cell)).replace(".", decimal) for cell in row)
        for row in rows
    ]


def text(
    header: str,
    separator: str = ",",
    decimal: str = ".",
    frame: pd.DataFrame = FRAME,
    above: str = "",
    below: str = "",
    end: str = "",
) -> str:
    lines = [header, *cells(frame, separator, decimal)]
    return above + "".join(f"{line}{end}\n" for line in lines) + below


def dated(form: str, frame: pd.DataFrame = FRAME) -> pd.DataFrame:
    """Return the record with dates in place of times; %f has milliseconds where %3f is written."""
    texts = [date.strftime(form.replace("%3f", f"{date.microsecond // 1000:03d}")) for date in DATES]
    return frame.assign(time=texts)


def marked(mark: str) -> str:
    """Return a text in which three samples of the current are missing, by a mark."""
    lines = text("time,u,i,w").splitlines()
    for row in (7, 8, 60):
        cell = lines[row].split(",")
        lines[row] = ",".join([*cell[:2], mark, cell[3]])
    return "\n".join(lines) + "\n"


def grouped(separator: str, thousands: str, decimal: str, quote: str = "") -> str:
    """Return a text whose speeds, in 1/min, have marks between thousands."""
    rows = []
    for row in IN_RPM.to_numpy():
        each = [repr(float(value)) for value in row]
        whole, part = each[3].lstrip("-").split(".")
        sign = "-" if row[3] < 0 else ""
        speed = f"{sign}{int(whole):,}".replace(",", thousands) + decimal + part
        rows.append(
            separator.join(f"{quote}{cell}{quote}" for cell in (*(c.replace(".", decimal) for c in each[:3]), speed))
        )
    return "\n".join([separator.join(["time", "u", "i", "w [rpm]"]), *rows]) + "\n"


def exponents(separator: str, mark: str) -> str:
    rows = (separator.join(f"{x:.17E}".replace("E", mark) for x in row) for row in FRAME.to_numpy())
    return separator.join(map(str, FRAME)) + "\n" + "\n".join(rows)


UNTIMED = FRAME[["u", "i", "w"]]
COLUMNS: dict[str, Any] = {str(name): values.to_numpy() for name, values in FRAME.items()}
MORE = FRAME.assign(x=1.0, y=2.0)[["time", "x", "u", "i", "w", "y"]]
NUMBERED = pd.concat([pd.Series([f'"{k + 1}"' for k in range(ROWS)], name="n"), FRAME], axis="columns")
STEPS = FRAME.copy()
for _k in np.flatnonzero(np.diff(FRAME["u"]))[::-1] + 1:
    _before = pd.DataFrame({"time": [FRAME["time"][_k]], "u": [FRAME["u"][_k - 1]], "i": np.nan, "w": np.nan})
    STEPS = pd.concat([STEPS[:_k], _before, STEPS[_k:]], ignore_index=True)
"""The record with each step of the input as two samples at one time, of which the first is not measured."""

TEXTS: dict[str, tuple[str, str | bytes]] = {
    "plain": ("a.csv", text("time,u,i,w")),
    "txt": ("a.txt", text("time,u,i,w")),
    "tsv": ("a.tsv", text("time\tu\ti\tw", "\t")),
    "dat with spaces": ("a.dat", text("time u i w", "  ")),
    "tabs": ("a.csv", text("time\tu\ti\tw", "\t")),
    "tabs and commas": ("a.txt", text("time\tu\ti\tw", "\t", ",")),
    "bars": ("a.csv", text("time|u|i|w", "|")),
    "semicolons": ("a.csv", text("time;u;i;w", ";")),
    "German": ("a.csv", text("time;u;i;w", ";", ",")),
    "German with mark": ("a.csv", text("time;u;i;w", ";", ",").encode("utf-8-sig")),
    "German of Windows": ("a.csv", text("time;u;i;w;Größe", ";", ",", FRAME.assign(x=1.0)).encode("cp1252")),
    "UTF-16": ("a.csv", text("time\tu\ti\tw", "\t", ",").encode("utf-16")),
    "line that says sep=": ("a.csv", text("time;u;i;w", ";", ",", above="sep=;\n")),
    "quoted commas": ("a.csv", text('time","u","i","w', '","', ",").replace("\n", '"\n"').join(('"', ""))[:-1]),
    "quoted": ("a.csv", text('"time","u","i","w"')),
    "quoted numbers": ("a.csv", text('time","u","i","w', '","').replace("\n", '"\n"').join(('"', ""))[:-1]),
    "carriage returns": ("a.csv", text("time,u,i,w").replace("\n", "\r\n")),
    "ends with separators": ("a.csv", text("time;u;i;w", ";", end=";")),
    "only rows end with separators": ("a.csv", text("time,u,i,w", end=",").replace("w,\n", "w\n", 1)),
    "spaces after commas": ("a.csv", text("time, u, i, w", ", ")),
    "comment lines": ("a.csv", text("time,u,i,w", above="# rig 4\n# rate: 100 Hz, gain 3\n")),
    "commented header": ("a.csv", text("# time,u,i,w")),
    "commented header, spaces": ("a.txt", text("# time u i w", " ")),
    "percent": ("a.csv", text("time,u,i,w", above="% of the rig\n")),
    "semicolon comments": ("a.csv", text("time;u;i;w", ";", above="; of the rig\n; 2026\n")),
    "preamble": ("a.csv", text("time;u;i;w", ";", ",", above="Rig;4\nRate;100\n\nOperator;A;B\n")),
    "preamble of numbers": ("a.csv", text("time,u,i,w", above="Recorder,X,Y,Z\n1,2,3,4\nName,a,b,c\n")),
    "unit row": ("a.csv", text("time,u,i,w\ns,V,A,rad/s")),
    "unit row, ms, rpm": ("a.csv", text("time;u;i;w\nms;V;A;rpm", ";", ",", MS.assign(w=IN_RPM["w"]))),
    "unit row in brackets": ("a.csv", text("time,u,i,w\n[ms],[V],[A],[1/min]", frame=MS.assign(w=IN_RPM["w"]))),
    "names, units, words": ("a.csv", text("time,u,i,w\ns,V,A,rad/s\nclock,supply,supply,shaft")),
    "time [s]": ("a.csv", text("time [s],u [V],i [A],w [rad/s]")),
    "Time (ms)": ("a.csv", text("Time (ms),u,i,w", frame=MS)),
    "time_ms": ("a.csv", text("time_ms,u,i,w", frame=MS)),
    "t": ("a.csv", text("t,u,i,w")),
    "T": ("a.csv", text("T,u,i,w")),
    "T beside Zeit": ("a.csv", text("T;Zeit;u;i;w", ";", frame=FRAME.assign(T=20.0)[["T", "time", "u", "i", "w"]])),
    "T in degrees": ("a.csv", text("Zeit;u;i;w;T [°C]", ";", frame=FRAME.assign(T=20.0)).encode("cp1252")),
    "Zeit in ms": ("a.csv", text("Zeit [ms];u;i;w", ";", ",", MS).encode("cp1252")),
    "µs": ("a.csv", text("Time (µs),u,i,w", frame=FRAME.assign(time=1000 * MS["time"]))),
    "min": ("a.csv", text("time [min],u,i,w", frame=FRAME.assign(time=FRAME["time"] / 60))),
    "h": ("a.csv", text("time [h],u,i,w", frame=FRAME.assign(time=FRAME["time"] / 3600))),
    "later start": ("a.csv", text("time,u,i,w", frame=FRAME.assign(time=FRAME["time"] + 1000))),
    "w (rpm)": ("a.csv", text("time,u,i,w (rpm)", frame=IN_RPM)),
    "w[n/min]": ("a.csv", text("time,u,i,w[n/min]", frame=IN_RPM)),
    "w_rpm": ("a.csv", text("time,u,i,w_rpm", frame=IN_RPM)),
    "i [mA]": ("a.csv", text("time,u,i [mA],w", frame=IN_MA)),
    "u/V": ("a.csv", text("time/s,u/V,i/A,w")),
    "i_mA": ("a.csv", text("time,u,i_mA,w", frame=IN_MA)),
    "u (mV)": ("a.csv", text("time,u (mV),i,w", frame=FRAME.assign(u=1000 * FRAME["u"]))),
    "u in kV": ("a.csv", text("time,u [kV],i,w", frame=FRAME.assign(u=FRAME["u"] / 1000))),
    "other names": ("a.csv", text("t,Voltage,I_meas [A],Drehzahl (rpm)", frame=IN_RPM)),
    "dates": ("a.csv", text("time,u,i,w", frame=dated("%Y-%m-%dT%H:%M:%S.%3f"))),
    "dates with zone": ("a.csv", text("time,u,i,w", frame=dated("%Y-%m-%dT%H:%M:%S.%3f+01:00"))),
    "dates of Germany": ("a.csv", text("time;u;i;w", ";", ",", dated("%d.%m.%Y %H:%M:%S,%3f"))),
    "dates of the US": ("a.csv", text("time,u,i,w", frame=dated("%m/%d/%Y %I:%M:%S.%3f %p"))),
    "dates of MATLAB": ("a.csv", text("time,u,i,w", frame=dated("%d-%b-%Y %H:%M:%S.%3f"))),
    "times of the day": ("a.csv", text("time,u,i,w", frame=dated("%H:%M:%S.%3f"))),
    "other order": ("a.csv", text("w,time,i,u", frame=FRAME[["w", "time", "i", "u"]])),
    "more columns": ("a.csv", text("time,x,u,i,w,y", frame=MORE)),
    "a column of text": ("a.csv", text("time,u,i,w,state", frame=FRAME.assign(state='"run, 2"'))),
    "index of pandas": ("a.csv", FRAME.to_csv()),
    "time as index of pandas": ("a.csv", FRAME.set_index("time").to_csv()),
    "time as index without a name": ("a.csv", FRAME.set_index("time").rename_axis(None).to_csv()),
    "row names of R": ("a.csv", text('"","time","u","i","w"', frame=NUMBERED)),
    "exponents": ("a.csv", exponents(",", "E")),
    "exponents of Fortran": ("a.dat", exponents(" ", "D")),
    "blank lines at the end": ("a.csv", text("time,u,i,w", below="\n\n  \n")),
    "lines of commas at the end": ("a.csv", text("time,u,i,w", below=",,,\n,,,\n")),
    "comment at the end": ("a.csv", text("time,u,i,w", below="# end of file\n")),
    "words at the end": ("a.csv", text("time,u,i,w", below="End of measurement\n")),
    "sums at the end": ("a.csv", text("time;u;i;w", ";", ",", below="Mean;;;1,5\n")),
    "header again": ("a.csv", text("time,u,i,w").replace(cells(FRAME)[60], "time,u,i,w\n" + cells(FRAME)[60])),
    "steps as two samples": ("a.csv", text("time,u,i,w", frame=STEPS).replace("nan", "")),
    "thousands of the US": ("a.csv", grouped(",", ",", ".", '"')),
    "thousands of Germany": ("a.csv", grouped(";", ".", ",")),
    "thousands of France": ("a.csv", grouped(";", "\u202f", ",")),
    "thousands of Switzerland": ("a.csv", grouped(";", "'", ".")),
    "interval above": ("a.txt", text("u i w", " ", ".", UNTIMED, "# rig 4\n# Sampling interval [ms] = 10\n")),
    "rate in cells above": ("a.csv", text("u [V];i [A];w", ";", ",", UNTIMED, "Abtastrate:;0,1;kHz\n\n")),
    "CSV of OpenModelica": ("a.csv", text('"time","u","i","w","der(w)"', frame=FRAME.assign(d=0.0))),
    # --- with missing samples: the estimates are those of empty cells ---
    "missing: empty": ("a.csv", marked("")),
    "missing: -": ("a.csv", marked("-")),
    "missing: ---": ("a.csv", marked(" --- ")),
    "missing: NaN": ("a.csv", marked("NaN")),
    "missing: #N/A": ("a.csv", marked("#N/A")),
    "missing: NULL": ("a.csv", marked("NULL")),
    "missing: -999": ("a.csv", marked("-999")),
    "missing: 1.#QNAN": ("a.csv", marked("1.#QNAN")),
    # --- what nobody can know ---
    "shuffled": ("a.csv", text("time,u,i,w", frame=FRAME.sample(frac=1.0, random_state=1))),
    "units and no names": ("a.csv", text("[s],[V],[A],[rad/s]")),
    "numbers alone": ("a.csv", text("time,u,i,w").split("\n", 1)[1]),
    "no times": ("a.csv", text("u,i,w", frame=FRAME[["u", "i", "w"]])),
    "ms, unsaid": ("a.csv", text("time,u,i,w", frame=MS)),
    "milliseconds since 1970": ("a.csv", text("timestamp,u,i,w", frame=MS.assign(time=MS["time"] + 1.7952e12))),
    "rpm, unsaid": ("a.csv", text("time,u,i,n", frame=IN_RPM)),
    "times without fractions": ("a.csv", text("time,u,i,w", frame=dated("%H:%M:%S"))),
}  # fmt: skip


for _texts in (instrument_texts, logger_texts, historian_texts, bench_texts, simulator_texts):
    TEXTS |= _texts.texts(FRAME, DATES)


def write_gzip(path: Path) -> None:
    path.write_bytes(gzip.compress(text("time,u,i,w").encode()))


def write_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", text("time;u;i;w", ";", ","))


def write_sheet(path: Path) -> None:
    """Write a book whose second sheet has the table, with an empty column and rows of text above it."""
    with pd.ExcelWriter(path, engine="odf" if path.suffix == ".ods" else "openpyxl") as book:
        pd.DataFrame({"about": ["the rig"]}).to_excel(book, sheet_name="about", index=False)
        MS.rename(columns={"time": "Time (ms)"}).to_excel(book, sheet_name="run", startrow=3, startcol=1, index=False)


def write_rows(path: Path, *above: list[Any], frame: pd.DataFrame = FRAME) -> None:
    pd.DataFrame([*above, *frame.to_numpy().tolist()]).to_excel(path, header=False, index=False)


def write_hdf(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        columns = {
            "time": (MS["time"], "ms"),
            "u": (FRAME["u"], "V"),
            "i": (IN_MA["i"], "mA"),
            "w": (IN_RPM["w"], "rpm"),
        }
        for name, (values, unit) in columns.items():
            group[name] = values
            group[name].attrs["unit"] = unit


def write_compound(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run"] = FRAME.to_records(index=False)


def write_hdf_matrix(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run"] = FRAME.to_numpy()
        file["run"].attrs["columns"] = [*FRAME]


def write_mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("run")
        for name, values in FRAME.items():
            group[name] = values.to_numpy()[np.newaxis, :]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_result(path: Path, *, transposed: bool) -> None:
    """Write a result file of OpenModelica and Dymola (transposed), or of Dymola's other form."""
    content = {
        "name": characters(["time", "u", "i", "w", "der(w)", "R"], "nul"),
        "description": characters(["Time [s]", "[V]", "[A]", "[rad/s]", "[rad/s2]", "[Ohm]"], "nul"),
        "dataInfo": np.array([[0, 1], [2, 2], [2, 3], [2, 4], [2, 5], [1, 2]], dtype=np.int32),
        "data_1": np.array([[0.0, 1.0], [1.19, 1.0]]),
        "data_2": FRAME.assign(d=0.0).to_numpy(),
    }
    turned = {name: value.T if transposed else value for name, value in content.items()}
    aclass = characters(["Atrajectory", "1.1", "", "binTrans" if transposed else "binNormal"], "nul")
    write_mat4(path, {"Aclass": aclass, **turned})


def write_tdms(path: Path) -> None:
    waveform = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    units = {"u": "V", "i": "mA", "w": "rpm"}
    columns = {"u": FRAME["u"], "i": IN_MA["i"], "w": IN_RPM["w"]}
    with TdmsWriter(path) as writer:
        writer.write_segment([
            ChannelObject("run", name, values.to_numpy(), properties=waveform | {"unit_string": units[name]})
            for name, values in columns.items()
        ])  # fmt: skip


def write_mdf(path: Path) -> Path:
    from asammdf import MDF, Signal

    units = {"u": "V", "i": "mA", "w": "rpm"}
    columns = {"u": FRAME["u"], "i": IN_MA["i"], "w": IN_RPM["w"]}
    times = FRAME["time"].to_numpy()
    with MDF(version="4.10" if path.suffix == ".mf4" else "3.30") as file:
        file.append([Signal(values.to_numpy(), times, name=name, unit=units[name]) for name, values in columns.items()])
        return Path(file.save(path))


def signals() -> np.ndarray[Any, Any]:
    """Return signals as Simulink writes them, a structure each."""
    found = np.zeros((1, 3), dtype=[("values", object), ("dimensions", object), ("label", object)])
    for j, name in enumerate("uiw"):
        found[0, j] = (COLUMNS[name][:, None], 1.0, name)
    return found


def one_signal(frame: pd.DataFrame) -> dict[str, Any]:
    """Return a structure with time of one signal with three elements."""
    signal = {"values": frame.to_numpy(), "dimensions": 3.0, "label": "y"}
    return {"time": COLUMNS["time"][:, None], "signals": signal, "blockName": "model/Scope"}


def write_scope73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        group, parts = file.create_group("Scope"), file.create_group("#refs#")
        group["time"] = COLUMNS["time"][None]
        own = group.create_group("signals")
        values, labels = (own.create_dataset(name, (3, 1), dtype=h5py.ref_dtype) for name in ("values", "label"))
        for j, name in enumerate("uiw"):
            parts[f"v{j}"], parts[f"l{j}"] = COLUMNS[name][None], np.array([[ord(name)]], dtype=np.uint16)
            parts[f"l{j}"].attrs["MATLAB_class"] = np.bytes_("char")
            values[j, 0], labels[j, 0] = parts[f"v{j}"].ref, parts[f"l{j}"].ref
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_control_desk(path: Path) -> None:
    axes = np.zeros((1, 1), dtype=[("Name", object), ("Data", object), ("Raster", object)])
    axes[0, 0] = ("Time", COLUMNS["time"][None], "HostService")
    found = np.zeros((1, 3), dtype=[("Name", object), ("Data", object), ("Unit", object), ("XIndex", object)])
    for j, (name, unit) in enumerate({"u": "V", "i": "A", "w": "rad/s"}.items()):
        found[0, j] = (f'"Model Root"/{name}', COLUMNS[name][None], unit, 1.0)
    savemat(path, {"rec_001": {"X": axes, "Y": found, "Description": "a run"}})


def write_two_rates(path: Path) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment([
            ChannelObject("run", name, COLUMNS[name][::k], properties={"wf_increment": k / 100, "wf_start_offset": 0.0})
            for name, k in {"u": 1, "i": 1, "w": 2}.items()
        ])  # fmt: skip


def write_vectors(path: Path, vectors: Mapping[str, Any]) -> None:
    with h5py.File(path, "w") as file:
        for name, values in vectors.items():
            file[name] = values


def write_with_summary(path: Path) -> None:
    """Write a book whose first sheet is a short summary."""
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        pd.DataFrame({"Channel": [8, 9], "Cycles": [1, 2]}).to_excel(book, sheet_name="Global_Info", index=False)
        FRAME.to_excel(book, sheet_name="Channel_1-008", index=False)


IDDATA = {
    "InputData": np.array([COLUMNS["u"][:, None], None], dtype=object)[:1],
    "OutputData": np.array([FRAME[["i", "w"]].to_numpy(), None], dtype=object)[:1],
    **{"Ts": 0.01, "Tstart": 0.0, "SamplingInstants": [], "TimeUnit": "seconds"},
    **{name: np.array([cell], dtype=object) for name, cell in (("InputName", "u"), ("InputUnit", "V"))},
    **{"OutputName": np.array(["i", "w"], dtype=object), "OutputUnit": np.array(["A", "rad/s"], dtype=object)},
}
"""An object of MATLAB's System Identification Toolbox, as it is stored."""
INSPECTOR = [None, *["Type: double"] * 3], [None, *(f"Units: {unit}" for unit in ("V", "A", "rad/s"))]
"""Rows below the names, of Simulink's Data Inspector."""
RIG, DRIVE = ["Rig 4", None, None, None], [None, "Drive", None, None]
Write = Callable[[Path], object]
FILES: dict[str, Write] = {
    "a.csv.gz": write_gzip,
    "a.zip": write_zip,
    "a.csv.zip": write_zip,
    "a.xlsx": write_sheet,
    "a.ods": write_sheet,
    "units.xlsx": lambda path: write_rows(path, [*FRAME], ["ms", "V", "A", "rad/s"], frame=MS),
    "texts.xlsx": lambda path: write_rows(path, [*FRAME], frame=FRAME.map(repr)),
    "above.xlsx": lambda path: write_rows(path, RIG, ["s", "V", "A", "rad/s"], [*FRAME]),
    "heads.xlsx": lambda path: write_rows(path, RIG, DRIVE, [*FRAME], ["s", "V", "A", "rad/s"]),
    "dates.xlsx": lambda path: FRAME.assign(time=DATES).to_excel(path, index=False),
    "index.xlsx": FRAME.to_excel,
    "a.parquet": FRAME.to_parquet,
    "index.parquet": FRAME.set_index("time").to_parquet,
    "dates.parquet": FRAME.assign(time=DATES).to_parquet,
    "zone.parquet": FRAME.assign(time=DATES.dt.tz_localize("Europe/Berlin")).to_parquet,
    "dated-index.parquet": FRAME[["u", "i", "w"]].set_index(pd.DatetimeIndex(DATES)).to_parquet,
    "durations.parquet": FRAME.assign(time=pd.to_timedelta(MS["time"], unit="ms")).to_parquet,
    "a.feather": FRAME.to_feather,
    "a.json": lambda path: FRAME.to_json(path, orient="records", double_precision=15),
    "columns.json": lambda path: path.write_text(json.dumps(FRAME.to_dict(orient="list"))),
    "a.h5": write_hdf,
    "compound.h5": write_compound,
    "matrix.h5": write_hdf_matrix,
    "fixed.h5": lambda path: FRAME.to_hdf(path, key="run"),
    "table.h5": lambda path: FRAME.to_hdf(path, key="run", format="table"),
    "vectors.mat": lambda path: savemat(path, COLUMNS),
    "v4.mat": lambda path: savemat(path, COLUMNS, format="4"),
    "structure.mat": lambda path: savemat(path, {"run": COLUMNS | {"rig": "4"}}),
    "matrix.mat": lambda path: savemat(path, {"data": FRAME.to_numpy(), "names": np.array([*FRAME], dtype=object)}),
    "unnamed.mat": lambda path: savemat(path, {"data": FRAME.to_numpy()}),
    "v73.mat": write_mat73,
    "Motor_res.mat": lambda path: write_result(path, transposed=True),
    "dsres.mat": lambda path: write_result(path, transposed=False),
    "a.tdms": write_tdms,
    "a.mf4": write_mdf,
    "scope.mat": lambda path: savemat(path, {"Scope": {"time": COLUMNS["time"][:, None], "signals": signals()}}),
    "scope-matrix.mat": lambda path: savemat(path, {"Scope": one_signal(FRAME[["u", "i", "w"]])}),
    "scope73.mat": write_scope73,
    "iddata.mat": lambda path: savemat(path, {"data": IDDATA}),
    "tout.mat": lambda path: savemat(path, {"tout" if name == "time" else name: v for name, v in COLUMNS.items()}),
    "recording.mat": write_control_desk,
    "rates.tdms": write_two_rates,
    "rates.h5": lambda path: write_vectors(path, COLUMNS | {"w": COLUMNS["w"][::2], "time_w": COLUMNS["time"][::2]}),
    "lost.h5": lambda path: write_vectors(path, COLUMNS | {"w": COLUMNS["w"][::2]}),
    "lost.mat": lambda path: savemat(path, COLUMNS | {"w": COLUMNS["w"][::2]}),
    "a.pq": FRAME.to_parquet,
    "summary.xlsx": write_with_summary,
    "inspector.xlsx": lambda path: write_rows(path, [*FRAME], *INSPECTOR),
    "mdf.dat": lambda path: write_mdf(path.with_suffix(".mf4")).rename(path),
    "text.xls": lambda path: path.write_text(text("time\tu\ti\tw", "\t")),
    "tables.xlsx": lambda path: write_rows(path, [*FRAME], *FRAME.to_numpy().tolist(), [*FRAME]),
    "page.xls": lambda path: path.write_text(FRAME.to_html()),
    "a.mdf": write_mdf,
    "comtrade.dat": lambda path: bench_texts.write_comtrade(path, FRAME),
    "comtrade.cfg": lambda path: bench_texts.write_comtrade(path, FRAME),
    "comtrade.cff": lambda path: bench_texts.write_comtrade(path, FRAME),
    "pscad_01.out": lambda path: bench_texts.write_pscad(path, FRAME),
    "commas.xlsx": lambda path: FRAME.map(lambda cell: repr(cell).replace(".", ",")).to_excel(path, index=False),
}  # fmt: skip


def writers() -> Mapping[str, tuple[str, Write]]:
    """Return all variants: what each is called, its file, and what writes that."""

    def writer(content: str | bytes) -> Write:
        return lambda path: path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return {name: (file, writer(content)) for name, (file, content) in TEXTS.items()} | {
        name: (name, write) for name, write in FILES.items()
    }


SAID = {
    "shuffled": "'time': row 2 goes back",
    "sums at the end": "'time': 'Mean' in row 121",
    "times without fractions": "'time' repeats 118 of 120 times",
    "no times": "'time' not found (columns: u, i, w)",
    "units and no names": "'time' not found (columns: [s], [V], [A], [rad/s])",
    "numbers alone": "no header",
    "ms, unsaid": "time unit looks wrong",
    "rpm, unsaid": "no column for the output w",
    "unnamed.mat": "no numeric vectors",
    "two Modelica tables": "2 Modelica tables",
    "one block below another": "row 121 goes back",
    "percent in cells": "unit '%' of 'w' does not convert",
    "Tektronix TDS": "no column for the input u",
    "Hantek DSO": "no column for the output",
    "Keysight InfiniiVision": "no column for the output",
    "scope-matrix.mat": "no column for the output",
    "minimum and maximum": "undecided: u Min or u Max",
    "two curves": "line 126 among the samples has no number",
    "marks among samples": "line 61 among the samples has no number ('MARK 001",
    "messages of a bus": "no table. Save it as CSV",
    "page.xls": "a page in HTML",
    "tables.xlsx": "row 121 of the samples has no number. Keep one table",
    "three levels": "rows of three levels",
    "JSON of nested lists": "column 'data' has lists in its cells",
    "a gain below the names": "line 'Gain' scales samples (0.1, 0.1, 1)",
    "frames of a timecode": "'12:00:01:24' in row 1 is no real number",
    "factors in a row of units": "unit 'A x 10' of 'i' does not convert",
    "units in capitals": "no column for the output i",
    "a factor above": "line 'Scale factor' scales samples (10)",
    "thousands that read as decimals": "may be thousands",
    "units below samples": "line 122 has units",
    "COMTRADE without scales": "rows of COMTRADE without scales",
    "commands of SQL": "commands of SQL",
    "Octave": "a matrix of Octave without names",
    "times in brackets, no names": "times in brackets without names",
    "microseconds, unsaid": "may be in ms, µs or ns",
    "lost.mat": "'w': 60 samples in place of 120",
    "lost.h5": "'w': 60 samples in place of 120",
}
"""Words that `fmuid init` says of the variants that do not lead to the same estimates."""
