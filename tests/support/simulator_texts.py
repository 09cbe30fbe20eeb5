"""The record of `tests.support.table_variants` as simulators, scopes and logs write blocks and lines of keys."""

from __future__ import annotations

import pandas as pd

from tests.support.text_rows import Fields, fields, tables

INSTEK = """Format,2.0B,Format,2.0B,Format,2.0B,
Memory Length,120,Memory Length,120,Memory Length,120,
Source,u,Source,i,Source,w,
Vertical Units,V,Vertical Units,A,Vertical Units,rad/s,
Sampling Period,1.0E-02,Sampling Period,1.0E-02,Sampling Period,1.0E-02,
Mode,Detail,Mode,Detail,Mode,Detail,
Waveform Data,,Waveform Data,,Waveform Data,,
"""
OWON = """Channel   :,CH1,CH2,CH3
Frequency :,F=1.000KHz,F=1.000KHz,?
Time interval :,10.00000mS,10.00000mS,10.00000mS

index,u(V),i(mA),w(rad/s)
"""
LABCHART = """Interval=\t0.01 s
ExcelDateTime=\t4.6348437500e+04\t11/22/2026 10:30:00
TimeFormat=\tStartOfBlock
ChannelTitle=\tu\ti\tw
Range=\t20.000 V\t5.000 A\t500 rad/s
UnitName=\tV\tA\trad/s
TopValue=\t20\t5\t500
BottomValue=\t-20\t-5\t-500
"""
ACQKNOWLEDGE = """run.acq
10 msec/sample
3 channels
u
Volts
i
Amps
w
rad/s
CH1\tCH2\tCH3\t
120\t120\t120\t
"""
MSR = """*CREATOR
MSR 5.12
*STARTTIME
2026-11-22;10:30:00;
*CHANNEL
TIME;u;i;w
*UNIT
;V;A;rad/s
*LIMITS
;;;
*DATA
"""
HALTECH = """%DataLog%
DataLogVersion : 1.1
Channel : u
ID : 384
DisplayMaxMin : 20,0
Channel : i
ID : 385
DisplayMaxMin : 5,-5
Channel : w
ID : 386
Log : 20261122 10:30:00
"""
BASYTEC = """~Resultfile from Basytec Battery Test System
~Date and Time of Data Converting: 22.11.2026 10:30:00
~
~Time[h]\tDataSet\tt-Step[h]\tCommand\tu[V]\ti[A]\tw[rad/s]
"""
MTS = """MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A

Data Header:\tTime:\t0.5\tSec\t11/22/2026 10:30:00 AM
Station Name:\tFrame 3

u\ti\tw\tTime
V\tA\trad/s\tSec
"""
SUNNY = """sep=;
Version CSV1|Tool SE|Linebreaks CR/LF|Delimiter semicolon|Decimalpoint comma

;SN: 2110;SN: 2110;SN: 2110
;u;i;w
;Analog;Analog;Analog
dd.MM.yyyy HH:mm:ss;V;A;rad/s
"""
DAY = "{d:%d.%m.%Y %H:%M:%S.%f}"
TABLES = {
    "GW Instek": ("a.csv", INSTEK, "{t:.6E},{u},{t:.6E},{i},{t:.6E},{w},"),
    "Hantek": ("a.csv", "#CHANNEL,u,i,w\n#CLOCK=10mS,,,\n#SIZE=120,,,\n#UNITS=V,A,rad/s,\n", "{u},{i},{w},"),
    "Owon": ("a.csv", OWON, "{k},{u},{ma},{w}"),
    "LabChart": ("a.txt", LABCHART, "{t}\t{u}\t{i}\t{w}"),
    "AcqKnowledge": ("a.txt", ACQKNOWLEDGE, "{u}\t{i}\t{w}\t"),
    "MSR": ("a.csv", MSR, "{d:%Y-%m-%d %H:%M:%S.%f};{u};{i};{w}"),
    "Haltech": ("a.csv", HALTECH, "{d:%H:%M:%S.%f},{u},{i},{w}"),
    "BaSyTec": ("a.txt", BASYTEC, "{h}\t{n}\t{h}\tCharge\t{u}\t{i}\t{w}"),
    "MTS 793": ("a.txt", MTS, "{u}\t{i}\t{w}\t{t}"),
    "Sunny Portal": ("a.csv", SUNNY, DAY + ";{U};{I};{W}"),
    "log of pairs": ("a.log", "", "ts={d:%Y-%m-%dT%H:%M:%S.%f}Z u={u} i={i} w={w}"),
    "Arduino": ("a.txt", "", "{d:%H:%M:%S.%f} -> u:{u},i:{i},w:{w}"),
    "line protocol": ("a.txt", "", "motor,host=rig u={u},i={i},w={w} {ns}"),
    "times in brackets": ("a.log", "time,u,i,w\n", "[{d:%Y-%m-%d %H:%M:%S.%f}] {u}, {i}, {w}"),
    "Igor": ("a.itx", "IGOR\nWAVES/D\tt\tu\ti\tw\nBEGIN\n", "\t{t}\t{u}\t{i}\t{w}", "END\n"),
    "Weka": (
        "a.arff",
        "@relation rig\n" + "".join(f"@attribute {name} numeric\n" for name in ("time", *"uiw")) + "@data\n",
        "{t},{u},{i},{w}",
    ),
    "Xyce": ("a.prn", "Index  TIME  u  i  w\n", "{k}  {t}  {u}  {i}  {w}", "End of Xyce(TM) Simulation\n"),
    "ticks of .NET": ("a.csv", "Ticks;u;i;w\n", "{ticks};{u};{i};{w}"),
    "uptime": ("a.csv", "Uptime,u,i,w\n", "0d 00h 00m {t:06.3f}s,{u},{i},{w}"),
    "Landt": ("a.csv", "Record,TestTime/Sec,StepTime/Sec,u/V,i/mA,w\n", "{n},{t},{t},{u},{ma},{w}"),
    # --- one channel ---
    "Hantek DSO": (
        "a.csv", "#timebase=2000000000000(ps)\n,#voltbase=1000000(uV)\n#size=120\n", "{t:.5E},{u}",
    ),
    # --- refused ---
    "Octave": ("a.txt", "# Created by Octave 8\n# name: d\n# type: matrix\n# rows: 120\n", "{t} {u} {i} {w}"),
    "times in brackets, no names": ("a.log", "", "[{d:%Y-%m-%d %H:%M:%S.%f}] {u}, {i}, {w}"),
    "microseconds, unsaid": ("a.csv", "timestamp,u,i,w\n", "{us},{u},{i},{w}"),
}  # fmt: skip
"""File name, head, format of a row and end, of each text with one line a row."""
PAGE = "{line}\nIndex   time   u   i   w\n{line}\n"


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each tool."""
    rows = fields(frame, dates)
    for k, row in enumerate(rows):
        us = round(1e4 * k)
        row |= {"us": 231_452_000 + us, "ticks": 639_156_042_000_000_000 + 10 * us}
        row |= {"ns": 1_795_343_400_000_000_000 + 1000 * us}
    found = tables(rows, TABLES)
    return found | {
        "raw file of SPICE": ("a.raw", _raw(rows)),
        "pages of SPICE": ("a.out", _pages(rows)),
        "Qucs": ("a.dat", _qucs(rows)),
        "OpenModelica's plots": ("a.plt", _plots(rows)),
        "Hantek, a block a channel": ("a.txt", _channels(rows)),
        "universal file": ("a.uff", _universal(rows)),
    }


def _raw(rows: list[Fields]) -> str:
    """Return a raw file of SPICE in ASCII."""
    names = "".join(f"\t{k}\t{name}\tvoltage\n" for k, name in enumerate(("time", *"uiw")))
    head = f"Title: rig\nPlotname: Transient Analysis\nFlags: real\nNo. Variables: 4\nNo. Points: {len(rows)}\n"
    points = (f" {row['k']}\t{row['t']}\n\t{row['u']}\n\t{row['i']}\n\t{row['w']}\n\n" for row in rows)
    return f"{head}Variables:\n{names}Values:\n{''.join(points)}"


def _pages(rows: list[Fields]) -> str:
    """Return a table that SPICE prints in pages."""
    head = f"      rig\n      Transient Analysis\n{PAGE.format(line='-' * 60)}"
    lines = [f"{row['k']}\t{row['t']:.9e}\t{row['u']}\t{row['i']}\t{row['w']}\t\n" for row in rows]
    return "\f\n".join(head + "".join(lines[k : k + 50]) for k in range(0, len(lines), 50))


def _qucs(rows: list[Fields]) -> str:
    """Return a data set of Qucs."""
    values = {name: "".join(f"  {row[name]:+.15e}\n" for row in rows) for name in "tuiw"}
    signals = (f"<dep {name} time>\n{values[name]}</dep>\n" for name in "uiw")
    return f"<Qucs Dataset 0.0.19>\n<indep time {len(rows)}>\n{values['t']}</indep>\n{''.join(signals)}"


def _plots(rows: list[Fields]) -> str:
    """Return a result of OpenModelica for Ptolemy's plots."""
    head = f"#Ptolemy Plot file, generated by OpenModelica\n#IntervalSize={len(rows)}\nXLabel: t\n\n"
    names = {"time": "t", "u": "u", "i": "i", "w": "w"}
    blocks = (
        f"DataSet: {name}\n" + "".join(f"{row['t']}, {row[key]}\n" for row in rows) for name, key in names.items()
    )
    return head + "\n".join(blocks)


def _channels(rows: list[Fields]) -> str:
    """Return blocks of Hantek, one below another."""
    form = "# CHANNEL:{}\n# CLOCK=10.0mS\n# SIZE={}\n# UNITS:{}\n\n{}\n\n"
    units = {"u": "V", "i": "A", "w": "rad/s"}
    return "".join(form.format(n, len(rows), unit, "\n".join(str(r[n]) for r in rows)) for n, unit in units.items())


def _universal(rows: list[Fields]) -> str:
    """Return a universal file with a time function per signal."""
    found = ""
    for name, unit in zip("uiw", ("V", "A", "rad/s"), strict=True):
        head = [name, "NONE", "22-Nov-26 10:30:00", "NONE", "NONE", "1 1 1 0 NONE 1 0 NONE 0 0"]
        head += [f"4 {len(rows)} 1 0.0 1.0e-2 0.0", "17 0 0 0 Time s", f"1 0 0 0 {name} {unit}"]
        head += ["0 0 0 0 NONE NONE"] * 2
        cells = [f"{row[name]!r:>25}" for row in rows]
        lines = ["".join(cells[k : k + 4]) for k in range(0, len(cells), 4)]
        found += "\n".join(["    -1", "    58", *head, *lines, "    -1", ""])
    return found
