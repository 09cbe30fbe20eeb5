"""The record of `tests.support.table_variants` as benches, grid recorders and scripts write texts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

NAMES = ["time", "u", "i", "w"]
TECPLOT = """# solver 4
TITLE = "rig"
VARIABLES = "time [s]" "u [V]" "i [A]" "w [rad/s]"
ZONE T="run 1", I=120, DATAPACKING=POINT
"""
TECPLOT_LINES = """TITLE     = "rig"
VARIABLES = "time"
"u"
"i"
"w"
ZONE T="run"
 I=120, J=1, K=1, ZONETYPE=Ordered
 DT=(DOUBLE DOUBLE DOUBLE DOUBLE )
"""
AMESIM = "# Simcenter Amesim\n# Time [s]\n# u [V]\n# i [A]\n# w [rad/s]\n"
IGNITION = '"#NAMES"\n"t_stamp","u","i","w"\n"#TYPES"\n"date","D","D","D"\n"#ROWS","120"\n'
FLUKE = "Logger 289\nSession,22 Nov\n\ntime,u,i,w\n"
COMTRADE = """rig,4,1999
3,3A,0D
1,u,,,V,1e-12,0,0,-32767,32767,1,1,P
2,i,,,A,1e-12,0,0,-32767,32767,1,1,P
3,w,,,rad/s,1e-12,0,0,-32767,32767,1,1,P
50
1
100,120
22/11/2026,10:30:00.000000
22/11/2026,10:30:00.000000
ASCII
1
"""
PSCAD = 'PGB({}) Output Desc="{}" Group="Main" Max=2.0 Min=-2.0 Units="{}"\n'
INSERT = "CREATE TABLE m (time REAL, u REAL, i REAL, w REAL);\n"


SECONDS = "{d:%Y/%m/%d},{d:%H:%M:%S}"
TOPICS = "\n".join(f'{{{{"topic": "{name}", "payload": {{{name}}}, "ts": {{t}}}}}}' for name in "uiw")
TAGS = "\n".join(f'"{name}";"{{d:%d.%m.%Y %H:%M:%S}}";{{c{name}}};1;{{day}}' for name in "uiw")
PLAIN = "{t},{u},{i},{w}"
TEXTS = {
    "zones by name": ("a.csv", "Zeit;u;i;w\n", "{d:%d.%m.%Y %H:%M:%S.%f} CET;{u};{i};{w}", ""),
    "units above names": ("a.csv", "ms;V;A;rpm\ntime;u;i;w\n", "{ms};{u};{i};{rpm}", ""),
    "names, words, units below": (
        "a.csv", "Zeit;u;i;w\nclock;supply;phase;shaft\n[ms];[V];[A];[rad/s]\n", "{ms};{u};{i};{w}", "",
    ),
    "commented names and units": ("a.txt", "# Names: time u i w\n# Units: ms V A rpm\n", "{ms} {u} {i} {rpm}", ""),
    "Tecplot": ("a.dat", TECPLOT, "  {t}  {u}  {i}  {w}", ""),
    "Tecplot, a line a name": ("a.dat", TECPLOT_LINES, "  {t}  {u}  {i}  {w}", ""),
    "Amesim": ("a.data", AMESIM, "{t:.14e} {u:.17e} {i:.17e} {w:.17e}", ""),
    "row numbers of R without a name": ("a.txt", '"time" "u" "i" "w"\n', '"{n}" {t} {u} {i} {w}', ""),
    "seconds and nanoseconds": (
        "a.csv", "header.seq,header.stamp.secs,header.stamp.nsecs,u,i,w\n", "{n},{d:%S},{part}000000,{u},{i},{w}", "",
    ),
    "Time and Time(ms)": ("a.csv", "Date,Time,Time(ms),u,i,w\n", SECONDS + ",{part},{u},{i},{w}", ""),
    "hours, minutes, seconds": ("a.txt", "h\tmin\ts\tu\ti\tw\n", "{e:%H}\t{e:%M}\t{e:%S.%f}\t{u}\t{i}\t{w}", ""),
    "times in digits": ("a.csv", "time,u,i,w\n", "{e:%H%M%S.%f},{u},{i},{w}", ""),
    "Ignition": ("a.csv", IGNITION, '"{d:%Y-%m-%d %H:%M:%S.%f}","{u}","{i}","{w}"', ""),
    "WinCC, below a second": ("a.csv", '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n', TAGS, ""),
    "Node-RED": ("a.jsonl", "", TOPICS, ""),
    "thousands of France in all columns": ("a.csv", "t [ms];u [mV];i [mA];w\n", "{ms};{mu};{mi};{cw}", ""),
    "units in all cells, lines above": ("a.csv", FLUKE, "{t} s,{u} VDC,{i} A,{w} rad/s", ""),
    "nodes of SPICE": ("a.txt", "time\tV(n001)\tI(L1)\tu\ti\tw\n", "{t}\t1.0\t2.0\t{u}\t{i}\t{w}", ""),
    "table of PostgreSQL": (
        "a.txt", " time | u | i | w\n------+---+---+---\n", " {d:%Y-%m-%d %H:%M:%S.%f}+01 | {u} | {i} | {w}",
        "(120 rows)\n\n",
    ),
    "minus of typesetters": ("a.csv", "time,u,i,w\n", PLAIN, ""),
    # --- refused ---
    "frames of a timecode": ("a.csv", "time,u,i,w\n", "12:00:{n:02}:24,{u},{i},{w}", ""),
    "factors in a row of units": ("a.csv", "time,u,i,w\ns,V,A x 10,rad/s\n", PLAIN, ""),
    "units in capitals": ("a.csv", "TIME [S],U [V],I [MA],W [RAD/S]\n", PLAIN, ""),
    "a gain below the names": ("a.csv", "time,u,i,w\ns,V,A,rad/s\nGain,0.1,0.1,1\n", PLAIN, ""),
    "a factor above": ("a.csv", "Scale factor: u=10 V/V\ntime,u,i,w\n", PLAIN, ""),
    "thousands that read as decimals": ("a.csv", "t [ms];u;i [mA];w\n", "{ms};{u};{whole};{w}", ""),
    "units below samples": ("a.csv", "time,u,i,w\n", "{ms},{u},{i},{w}", "ms,V,A,rad/s\n"),
    "COMTRADE without scales": ("a.dat", "", "{n},{ms},{n},{n},{n}", ""),
    "commands of SQL": ("a.sql", INSERT, "INSERT INTO m VALUES({t},{u},{i},{w});", ""),
}  # fmt: skip
"""File, lines above, lines of a row, and lines below, of each tool."""


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each tool, of a record of time, u, i, w in steps of 10 ms."""
    rows = [_cells(k, dates, *row) for k, row in enumerate(frame[NAMES].to_numpy().tolist())]
    found = {
        name: (file, above + "".join(form.format(**row) + "\n" for row in rows) + below)
        for name, (file, above, form, below) in TEXTS.items()
    }
    file, text = found["minus of typesetters"]
    return found | {"minus of typesetters": (file, text.replace("-", "\u2212"))}


def _cells(k: int, dates: pd.Series, t: float, u: float, i: float, w: float) -> dict[str, object]:
    """Return the cells of row k."""
    date = dates.iloc[k]
    day = (date - pd.Timestamp("1899-12-30")) / pd.Timedelta(days=1)
    cells = {"n": k + 1, "t": t, "ms": 10 * k, "d": date, "part": date.microsecond // 1000}
    late = date + (pd.Timestamp("2026-11-22T12:59:59.500") - dates.iloc[0])
    cells |= {"e": late, "day": f"{1e6 * day:.6f}".replace(".", ",")}
    french = str.maketrans(",.", "\u202f,")
    cells |= {"u": u, "i": i, "w": w, "rpm": w * 30 / np.pi, "whole": f"{round(5e3 * i):,}".replace(",", ".")}
    cells |= {f"m{name}": f"{1e3 * each:,.9f}".translate(french) for name, each in (("u", u), ("i", i))}
    return cells | {f"c{name}": str(each).replace(".", ",") for name, each in (("u", u), ("i", i), ("w", w))}


def write_comtrade(path: Path, frame: pd.DataFrame) -> None:
    """Write samples as integers, their scales beside them; a combined file has both."""
    cells = (frame[["u", "i", "w"]].to_numpy() * 1e12).round().astype(np.int64).tolist()
    rows = "".join(f"{k + 1},{10_000 * k},{','.join(map(str, row))}\r\n" for k, row in enumerate(cells))
    if path.suffix == ".cff":
        head = "--- file type: CFG ---\n" + COMTRADE + "--- file type: INF ---\n--- file type: DAT ASCII ---\n"
        path.write_text(head + rows)
        return
    path.with_suffix(".cfg").write_text(COMTRADE)
    path.with_suffix(".dat").write_text(rows)


def write_pscad(path: Path, frame: pd.DataFrame) -> None:
    """Write rows below a title, names and units beside them."""
    units = (("u", "kV"), ("i", "kA"), ("w", "rad/s"))
    channels = "".join(PSCAD.format(k, name, unit) for k, (name, unit) in enumerate(units, start=1))
    path.with_name(f"{path.stem.rpartition('_')[0]}.inf").write_text(channels)
    rows = frame.assign(u=frame["u"] / 1000, i=frame["i"] / 1000)[NAMES].to_numpy().tolist()
    path.write_text("a case\n" + "".join("  ".join(map(repr, row)) + "\n" for row in rows))
