"""The record of `tests.support.table_variants` as instruments and simulators write texts."""

from __future__ import annotations

from itertools import chain, repeat

import pandas as pd

from tests.support.text_rows import fields, tables

LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
X_Columns\t{columns}
Date\t2026/11/22
Time\t10:30:00.123
***End_of_Header***\t
\t
Channels\t3\t\t\t
Samples\t120\t120\t120\t
Y_Unit_Label\tVolts\tAmps\trad/s\t
X_Dimension\tTime\tTime\tTime\t
X0\t0.0E+0\t0.0E+0\t0.0E+0\t
Delta_X\t0.010000\t0.010000\t0.010000\t
***End_of_Header***\t\t\t\t
"""
TEKTRONIX = """Model,MSO54
Firmware Version,1.2.3

Horizontal Units,s
Sample Interval,0.01
Record Length,120
Probe Attenuation,10,10,1
Vertical Units,V,A,rad/s
Vertical Offset,0,0,0
,,,
Label,u,i,w
TIME,u,i,w
"""
YOKOGAWA = """"Model Name","DL850"
"BlockNumber",1
"TraceName","u","i","w"
"BlockSize",120,120,120
"VUnit","V","mA","rpm"
"SampleRate",1.0E+02,1.0E+02,1.0E+02
"HResolution",1.0E-02,1.0E-02,1.0E-02
"HUnit","s","s","s"
"Date","2026/11/22","2026/11/22","2026/11/22"
"Time","10:30:00.00","10:30:00.00","10:30:00.00"

"""
KEYSIGHT = """Name:,Scan 1
Acquisition Date:,11/22/2026 10:30:00 AM
Instrument:,34970A
Channel,Name,Function
101,u,DC volts

Scan,Time,u (VDC),i (ADC),w (rad/s)
"""
GRAPHTEC = """Vendor,Graphtec Corporation
Sampling interval,10ms
Number,Date&Time,ms,u,i,w,Alarm
NO.,Time,ms,V,A,rad/s,A12345
"""
DEWESOFT = """Data info
File name: x.dxd
Start time: 11/22/2026 10:30:00.000
Sample rate: 100


Time (s),u (V),i (A),w (rad/s)
"""
CATMAN = """HBM_CATMANEASYASCIIOUTPUT 5.0
Start time: 22.11.2026 10:30:00
Number of channels: 4
Time  1 - default sample rate\tu\ti\tw
s\tV\tA\trad/s
"""
TWINCAT = """Name\trecord
File\tC:\\record.csv
Starttime of export\t132959733843760000\tMontag, 2. Mai 2022\t15:56:24.376
Endtime of export\t132959733853750000\tMontag, 2. Mai 2022\t15:56:25.375


Name\tu\tName\ti\tw
Data-Type\tREAL64\tData-Type\tREAL64\tREAL64
SampleTime[ms]\t10\tSampleTime[ms]\t10\t10
Unit\tV\tUnit\tA\t(None)
Unit ScaleFactor\t1\tUnit ScaleFactor\t1\t1

"""


def labview(columns: str, decimal: str = ".") -> str:
    """Return the head of LabVIEW with one column of times, none ("No"), or one each ("Multi")."""
    names = "X_Value\tu\tX_Value\ti\tX_Value\tw" if columns == "Multi" else "X_Value\tu\ti\tw"
    return LABVIEW.format(decimal=decimal, columns=columns) + names + "\tComment\n"


ROW, TABS = "{t},{u},{i},{w}", "{t}\t{u}\t{i}\t{w}"
INCA = "ETASAsciiItemFile\trecord\tTab\n\ntime\tu\ti\tw\ns\tV\tA\trad/s\n"
TABLES = {
    "LabVIEW": ("a.lvm", labview("One"), TABS),
    "LabVIEW, German": ("a.lvm", labview("One", ","), TABS.upper()),
    "LabVIEW without times": ("a.lvm", labview("No"), "\t{u}\t{i}\t{w}"),
    "LabVIEW, times again": ("a.lvm", labview("Multi"), "{t}\t{u}\t{t}\t{i}\t{t}\t{w}"),
    "Tektronix MSO": ("a.csv", TEKTRONIX, ROW),
    "Yokogawa": ("a.csv", YOKOGAWA, ",{u},{ma},{rpm}"),
    "Yokogawa WT": (
        "a.csv", "Store No.,Date,Time,Millisecond,u,i,w\n", "{k},{d:%Y/%m/%d},{d:%H:%M:%S},{m},{u},{i},{w}",
    ),
    "Keysight 34970A": ("a.csv", KEYSIGHT, "{k},{d:%m/%d/%Y %H:%M:%S}:{m:03d},{u},{i},{w}"),
    "Graphtec": ("a.csv", GRAPHTEC, "{k},{d:%Y/%m/%d %H:%M:%S},{m},{u},{i},{w},LL"),
    "Siglent": ("a.csv", "Sample Interval,0.01\nSource,u,i,w\nSecond,Volt,Ampere,rad/s\n", ROW),
    "Rigol": ("a.csv", "X,u,i,w,Start,Increment,\nSequence,V,A,rad/s,0.0e+00,1.0e-02,\n", "{k},{u},{i},{w},,"),
    "PicoScope": ("a.csv", "Time,u,i,w\n(ms),(V),(A),(rad/s)\n\n", "{ms},{u},{i},{w}"),
    "catman": ("a.asc", CATMAN, TABS.upper()),
    "DEWESoft": ("a.csv", DEWESOFT, ROW),
    "Rohde & Schwarz": ("a.csv", "in s,u in V,i in A,w in rad/s\n", ROW),
    "Hioki": ("a.csv", 'HIOKI 8861 DATA\nTITLE,"x"\n"Time","u[V]","i[A]","w[rad/s]"\n', ROW),
    "INCA": ("a.ascii", INCA, TABS),
    "ANSYS": ("a.tab", '"Time [ms]"\t"u [V]"\t"i [A]"\t"w [rad/s]"\n', "{ms}\t{u}\t{i}\t{w}"),
    "PSIM": ("a.txt", "Time       u       i     w\n", " {t}   {u}   {i}   {w}"),
    "timetable of MATLAB": ("a.csv", "Time,u,i,w\n", "{t} sec,{u},{i},{w}"),
    "date and time of Germany": ("a.csv", "Datum;Uhrzeit;u;i;w\n", "{d:%d.%m.%Y};{d:%H:%M:%S},{m:03d};{U};{I};{W}"),
    "date and time of the US": (
        "a.csv", "Date,Time,u,i,w\n", "{d:%m/%d/%Y},{d:%I:%M:%S}.{m:03d} {d:%p},{u},{i},{w}",
    ),
    "TwinCAT Scope": ("a.csv", TWINCAT, "{ms}\t{u}\t{ms}\t{i}\t{w}", "EOF\n"),
    "days of spreadsheets": ("a.csv", "Date,u,i,w\n", "{days},{u},{i},{w}"),
    "CombiTimeTable": ("a.txt", "#1\n# time u i w\ndouble tab1(120,4)\n", "{t} {u} {i} {w}"),
    # --- one channel, or names that are numbers: other names than the model's ---
    "Tektronix TDS": ("F0000CH1.CSV", "", "{t},{i},"),
    "Keysight InfiniiVision": ("a.csv", "x-axis,1,2,3\nsecond,Volt,Ampere,Volt\n", ROW),
    # --- refused ---
    "two Modelica tables": ("a.txt", "#1\ndouble tab1(120,4)\n", "{t} {u} {i} {w}", "double tab2(2,2)\n0 1\n1 2\n"),
    "one block below another": ("a.csv", "time,u,i,w\n", ROW),
    "percent in cells": ("a.csv", "time,u,i,w\n", f"{ROW} %"),
}  # fmt: skip
"""File name, head, format of a row and end, of each text with one line a row."""
SETTINGS = ("Record Length,120,", "Sample Interval,0.01,", "Source,i,", "Vertical Units,A,", "Horizontal Units,s,")


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each instrument."""
    found = tables(fields(frame, dates), TABLES)
    file, plain = found["Tektronix TDS"]
    heads = chain(SETTINGS, repeat(",,"))
    found["Tektronix TDS"] = (file, "".join(f"{next(heads)},{line}" for line in plain.splitlines(keepends=True)))
    file, block = found["one block below another"]
    return found | {
        "JSON lines": ("a.jsonl", frame.to_json(orient="records", lines=True, double_precision=15)),
        "JSON, split": ("a.json", frame.to_json(orient="split", double_precision=15)),
        "JSON, index": ("a.json", frame.to_json(orient="index", double_precision=15)),
        "JSON, table": ("a.json", frame.to_json(orient="table", index=False, double_precision=15)),
        "one block below another": (file, 2 * block),
        "rows are columns": ("a.csv", "".join(f"{c},{','.join(map(repr, frame[c].tolist()))}\n" for c in frame)),
    }
