"""The record of `tests.support.table_variants` as instruments and simulators write texts."""

from __future__ import annotations

import pandas as pd

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


def lines(frame: pd.DataFrame, separator: str = ",", decimal: str = ".", before: str = "", after: str = "") -> str:
    """Return the rows of a frame."""
    rows = [separator.join(repr(cell).replace(".", decimal) for cell in row) for row in frame.to_numpy().tolist()]
    return "".join(f"{before}{row}{after}\n" for row in rows)


def labview(columns: str, rows: str, decimal: str = ".") -> str:
    """Return a text of LabVIEW with one column of times, none ("No"), or one each ("Multi")."""
    names = "X_Value\tu\tX_Value\ti\tX_Value\tw" if columns == "Multi" else "X_Value\tu\ti\tw"
    return LABVIEW.format(decimal=decimal, columns=columns) + names + "\tComment\n" + rows


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each instrument, of a record of time, u, i, w in steps of 10 ms."""
    bare, ms = frame[["u", "i", "w"]], frame.assign(time=1e3 * frame["time"])
    mixed = bare.assign(i=1e3 * bare["i"], w=bare["w"] * 9.549296585513721)
    rows = lines(bare).splitlines()
    days = [f"{each:%Y/%m/%d %H:%M:%S}" for each in dates]
    parts = [each.microsecond // 1000 for each in dates]
    dated = list(enumerate(zip(days, parts, rows, strict=True)))
    stamped = list(zip(dates, parts, rows, strict=True))
    timed = zip(frame["time"].tolist(), rows, strict=True)
    repeated = pd.concat([frame["time"], frame["u"], frame["time"], frame["i"], frame["time"], frame["w"]], axis=1)
    settings = ["Record Length,120,", "Sample Interval,0.01,", "Source,i,", "Vertical Units,A,", "Horizontal Units,s,"]
    single = lines(frame[["time", "i"]]).splitlines()
    return {
        "LabVIEW": ("a.lvm", labview("One", lines(frame, "\t"))),
        "LabVIEW, German": ("a.lvm", labview("One", lines(frame, "\t", ","), ",")),
        "LabVIEW without times": ("a.lvm", labview("No", lines(bare, "\t", before="\t"))),
        "LabVIEW, times again": ("a.lvm", labview("Multi", lines(repeated, "\t"))),
        "Tektronix MSO": ("a.csv", TEKTRONIX + lines(frame)),
        "Yokogawa": ("a.csv", YOKOGAWA + lines(mixed, before=",")),
        "Yokogawa WT": (
            "a.csv",
            "Store No.,Date,Time,Millisecond,u,i,w\n"
            + "".join(f"{k},{day.replace(' ', ',')},{part},{row}\n" for k, (day, part, row) in dated),
        ),
        "Keysight 34970A": (
            "a.csv",
            KEYSIGHT
            + "".join(f"{k},{d[5:10]}/{d[:4]}{d[10:]}:{part:03d},{row}\n" for k, (d, part, row) in dated),
        ),
        "Graphtec": ("a.csv", GRAPHTEC + "".join(f"{k},{day},{part},{row},LL\n" for k, (day, part, row) in dated)),
        "Siglent": ("a.csv", "Sample Interval,0.01\nSource,u,i,w\nSecond,Volt,Ampere,rad/s\n" + lines(frame)),
        "Rigol": (
            "a.csv",
            "X,u,i,w,Start,Increment,\nSequence,V,A,rad/s,0.0e+00,1.0e-02,\n"
            + "".join(f"{k},{r},,\n" for k, r in enumerate(rows)),
        ),
        "PicoScope": ("a.csv", "Time,u,i,w\n(ms),(V),(A),(rad/s)\n\n" + lines(ms)),
        "catman": ("a.asc", CATMAN + lines(frame, "\t", ",")),
        "DEWESoft": ("a.csv", DEWESOFT + lines(frame)),
        "Rohde & Schwarz": ("a.csv", "in s,u in V,i in A,w in rad/s\n" + lines(frame)),
        "Hioki": ("a.csv", 'HIOKI 8861 DATA\nTITLE,"x"\n"Time","u[V]","i[A]","w[rad/s]"\n' + lines(frame)),
        "INCA": ("a.ascii", "ETASAsciiItemFile\trecord\tTab\n\ntime\tu\ti\tw\ns\tV\tA\trad/s\n" + lines(frame, "\t")),
        "ANSYS": ("a.tab", '"Time [ms]"\t"u [V]"\t"i [A]"\t"w [rad/s]"\n' + lines(ms, "\t")),
        "PSIM": ("a.txt", "Time       u       i     w\n" + lines(frame, "   ", before=" ")),
        "timetable of MATLAB": ("a.csv", "Time,u,i,w\n" + "".join(f"{t!r} sec,{row}\n" for t, row in timed)),
        "date and time of Germany": (
            "a.csv",
            "Datum;Uhrzeit;u;i;w\n"
            + "".join(
                f"{each:%d.%m.%Y};{each:%H:%M:%S},{p:03d};{r}\n"
                for each, p, r in zip(dates, parts, lines(bare, ";", ",").splitlines(), strict=True)
            ),
        ),
        "date and time of the US": (
            "a.csv",
            "Date,Time,u,i,w\n"
            + "".join(
                f"{each:%m/%d/%Y},{each:%I:%M:%S}.{part:03d} {each:%p},{row}\n" for each, part, row in stamped
            ),
        ),
        "TwinCAT Scope": ("a.csv", TWINCAT + lines(ms.iloc[:, [0, 1, 0, 2, 3]], "\t") + "EOF\n"),
        "days of spreadsheets": ("a.csv", "Date,u,i,w\n" + lines(frame.assign(time=46348.4375 + ms["time"] / 864e5))),
        "CombiTimeTable": ("a.txt", "#1\n# time u i w\ndouble tab1(120,4)\n" + lines(frame, " ")),
        "JSON lines": ("a.jsonl", frame.to_json(orient="records", lines=True, double_precision=15)),
        "JSON, split": ("a.json", frame.to_json(orient="split", double_precision=15)),
        "JSON, index": ("a.json", frame.to_json(orient="index", double_precision=15)),
        "JSON, table": ("a.json", frame.to_json(orient="table", index=False, double_precision=15)),
        # --- one channel, or names that are numbers: other names than the model's ---
        "Tektronix TDS": (
            "F0000CH1.CSV",
            "".join(f"{settings[k] if k < len(settings) else ',,'},{row},\n" for k, row in enumerate(single)),
        ),
        "Keysight InfiniiVision": ("a.csv", "x-axis,1,2,3\nsecond,Volt,Ampere,Volt\n" + lines(frame)),
        # --- refused ---
        "two Modelica tables": (
            "a.txt", "#1\ndouble tab1(120,4)\n" + lines(frame, " ") + "double tab2(2,2)\n0 1\n1 2\n"
        ),
        "one block below another": ("a.csv", "time,u,i,w\n" + lines(frame) + "time,u,i,w\n" + lines(frame)),
        "percent in cells": ("a.csv", "time,u,i,w\n" + lines(frame, after=" %")),
        "rows are columns": ("a.csv", "".join(f"{c},{','.join(map(repr, frame[c].tolist()))}\n" for c in frame)),
    }  # fmt: skip
