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


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each tool, of a record of time, u, i, w in steps of 10 ms."""
    rows: list[list[float]] = frame[NAMES].to_numpy().tolist()
    late = dates + (pd.Timestamp("2026-11-22T12:59:59.500") - dates.iloc[0])
    days = (dates - pd.Timestamp("1899-12-30")) / pd.Timedelta(days=1)

    def table(head: str, form: str) -> str:
        """Return a text with one line a row."""
        return head + "".join(
            form.format(
                n=k + 1,
                t=t,
                ms=10 * k,
                d=dates.iloc[k],
                e=late.iloc[k],
                part=dates.iloc[k].microsecond // 1000,
                day=f"{1e6 * days.iloc[k]:.6f}".replace(".", ","),
                u=u,
                i=i,
                w=w,
                mu=f"{1e3 * u:,.9f}".translate(str.maketrans(",.", "\u202f,")),
                mi=f"{1e3 * i:,.9f}".translate(str.maketrans(",.", "\u202f,")),
                cu=str(u).replace(".", ","),
                ci=str(i).replace(".", ","),
                cw=str(w).replace(".", ","),
                whole=f"{round(5e3 * i):,}".replace(",", "."),
                rpm=w * 30 / np.pi,
            )
            + "\n"
            for k, (t, u, i, w) in enumerate(rows)
        )

    seconds = "{d:%Y/%m/%d},{d:%H:%M:%S}"
    topics = "".join(f'{{{{"topic": "{name}", "payload": {{{name}}}, "ts": {{t}}}}}}\n' for name in "uiw")
    tags = "".join(f'"{name}";"{{d:%d.%m.%Y %H:%M:%S}}";{{c{name}}};1;{{day}}\n' for name in "uiw")
    commented = "# Names: time u i w\n# Units: ms V A rpm\n"
    return {
        "zones by name": ("a.csv", table("Zeit;u;i;w\n", "{d:%d.%m.%Y %H:%M:%S.%f} CET;{u};{i};{w}")),
        "units above names": ("a.csv", table("ms;V;A;rpm\ntime;u;i;w\n", "{ms};{u};{i};{rpm}")),
        "names, words, units below": (
            "a.csv", table("Zeit;u;i;w\nclock;supply;phase;shaft\n[ms];[V];[A];[rad/s]\n", "{ms};{u};{i};{w}"),
        ),
        "commented names and units": ("a.txt", table(commented, "{ms} {u} {i} {rpm}")),
        "Tecplot": ("a.dat", table(TECPLOT, "  {t}  {u}  {i}  {w}")),
        "Tecplot, a line a name": ("a.dat", table(TECPLOT_LINES, "  {t}  {u}  {i}  {w}")),
        "Amesim": ("a.data", table(AMESIM, "{t:.14e} {u:.17e} {i:.17e} {w:.17e}")),
        "row numbers of R without a name": ("a.txt", table('"time" "u" "i" "w"\n', '"{n}" {t} {u} {i} {w}')),
        "seconds and nanoseconds": (
            "a.csv",
            table("header.seq,header.stamp.secs,header.stamp.nsecs,u,i,w\n", "{n},{d:%S},{part}000000,{u},{i},{w}"),
        ),
        "Time and Time(ms)": ("a.csv", table("Date,Time,Time(ms),u,i,w\n", f"{seconds},{{part}},{{u}},{{i}},{{w}}")),
        "hours, minutes, seconds": ("a.txt", table("h\tmin\ts\tu\ti\tw\n", "{e:%H}\t{e:%M}\t{e:%S.%f}\t{u}\t{i}\t{w}")),
        "times in digits": ("a.csv", table("time,u,i,w\n", "{e:%H%M%S.%f},{u},{i},{w}")),
        "Ignition": ("a.csv", table(IGNITION, '"{d:%Y-%m-%d %H:%M:%S.%f}","{u}","{i}","{w}"')),
        "WinCC, below a second": (
            "a.csv", table('"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n', tags.rstrip("\n")),
        ),
        "Node-RED": ("a.jsonl", table("", topics.rstrip("\n"))),
        "thousands of France in all columns": ("a.csv", table("t [ms];u [mV];i [mA];w\n", "{ms};{mu};{mi};{cw}")),
        "units in all cells, lines above": ("a.csv", table(FLUKE, "{t} s,{u} VDC,{i} A,{w} rad/s")),
        "nodes of SPICE": ("a.txt", table("time\tV(n001)\tI(L1)\tu\ti\tw\n", "{t}\t1.0\t2.0\t{u}\t{i}\t{w}")),
        "table of PostgreSQL": (
            "a.txt",
            table(" time | u | i | w\n------+---+---+---\n", " {d:%Y-%m-%d %H:%M:%S.%f}+01 | {u} | {i} | {w}")
            + "(120 rows)\n\n",
        ),
        "minus of typesetters": ("a.csv", table("time,u,i,w\n", "{t},{u},{i},{w}").replace("-", "\u2212")),
        # --- refused ---
        "frames of a timecode": ("a.csv", table("time,u,i,w\n", "12:00:{n:02}:24,{u},{i},{w}")),
        "factors in a row of units": ("a.csv", table("time,u,i,w\ns,V,A x 10,rad/s\n", "{t},{u},{i},{w}")),
        "units in capitals": ("a.csv", table("TIME [S],U [V],I [MA],W [RAD/S]\n", "{t},{u},{i},{w}")),
        "a gain below the names": ("a.csv", table("time,u,i,w\ns,V,A,rad/s\nGain,0.1,0.1,1\n", "{t},{u},{i},{w}")),
        "a factor above": ("a.csv", table("Scale factor: u=10 V/V\ntime,u,i,w\n", "{t},{u},{i},{w}")),
        "thousands that read as decimals": ("a.csv", table("t [ms];u;i [mA];w\n", "{ms};{u};{whole};{w}")),
        "units below samples": ("a.csv", table("time,u,i,w\n", "{ms},{u},{i},{w}") + "ms,V,A,rad/s\n"),
        "COMTRADE without scales": ("a.dat", table("", "{n},{ms},{n},{n},{n}")),
        "commands of SQL": ("a.sql", table(INSERT, "INSERT INTO m VALUES({t},{u},{i},{w});")),
    }  # fmt: skip


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
