"""The record of `tests.support.table_variants` as historians, vehicles, controllers and simulators write texts."""

from __future__ import annotations

import pandas as pd

from tests.support.text_rows import fields, signals, tables

HOBO = """\ufeff"Plot Title: rig"
"#","Date Time, GMT+01:00","u, V (LGR S/N: 1, SEN S/N: 2)","i, A (LGR S/N: 1)","w, rad/s (LGR S/N: 1)","Stop (S/N: 1)"
"""
MOTEC = """"Format","MoTeC CSV File",,,"Workbook",""
"Venue","",,,"Worksheet",""
"Sample Rate","100.000","Hz",,"End Time","1.190","s"
"Range","entire outing",,,"End Distance","0","m"


"Time","u","i","w"
"s","V","A","rad/s"


"""
AIM = 'Format,AiM CSV File\nDate,"Monday, May 5"\nTime,10:00 AM\nSample Rate,100\n\nTime,u,i,w\ns,V,A,rad/s\n\n'
HP_TUNERS = "HP Tuners CSV Log File\n\n[Channel Information]\n0,12,23,50\nOffset,u,i,w\ns,V,A,rad/s\n\n[Channel Data]\n"
VCDS = """Sunday,22,November,2026,10:30:00:12345-VCID:AB-1,VCDS Version: 23.3

,Group A:,'001,,Group B:,'002
,,u,,i,,w
,TIME,,TIME,,TIME,
Marker,STAMP, V,STAMP, A,STAMP, rad/s
"""
RECORDER = """Device Type,GP10,
Ch.,,,CH1,,CH2,,CH3,
Tag,,,u,,i,,w,
Unit,,,V,,A,,rad/s,
Date,Time,ms,Min,Max,Min,Max,Min,Max
"""
DIGATRON = """Measurement ID,5
Time Stamp,Step,Status,Prog Time,Step Time,Procedure,u,i,w,
,,,,,,[V],[A],[rad/s],
"""
VICTRON = (
    '"timestamp","Battery [7]","Battery [7]","Motor [4]"\n"Europe/Berlin (+01:00)","u","i","w"\n"","V","A","rad/s"\n'
)
FLUENT = '"report-file-0"\n"Time Step" "u etc.."\n("Time Step" "u" "i" "w" "flow-time")\n'
INFLUX = (
    "#datatype,string,long,dateTime:RFC3339,double,string\n#group,false,false,false,false,true\n#default,_result,,,,\n"
)
CURVE = "CURVE{}\tTABLE\t120\n\tPt\tT\tu\ti\tw\tOver\n\t#\ts\tV\tA\trad/s\tbits\n"
CAN = "date Sun Nov 22 10:30:00 2026\nbase hex\nBegin Triggerblock\n   0.000000 Start of measurement\n"
TREND = "Controller Name:,Rig\nTrend Tags:,3\nSample Period:,10 ms\nHeader:,Date,Time,u,i,w\n"
LUTRON = "Place,Date,Time,u_value,u_Unit,i_value,i_Unit,w_value,w_Unit\n"
INCA = "ETASAsciiItemFile\trecord\tCrLf\tTab\nsampleCount\t120\ntime\tu\ti\tw\nf8\tf8\tf8\tf8\ns\tV\tA\trad/s\n"
LEVELS = (
    "Cycle ID,Cap(mAh),,,,\n,Step ID,Name,Step Time,,\n,,Record ID,Time,u(V),i(A),w\n1,10,,,,,\n,1,CC,0:00:00.4,,,\n"
)
DL950 = """"TraceName","u","i","w"
"VUnit","V","A","rad/s"
"HResolution",1.0E-02,1.0E-02,1.0E-02
"HUnit","s","s","s"

"""
TINYTAG = ",Serial number,1,,\n,Property,u,i,w\n,,V,A,rad/s\n"
CURVE_ROW = "\t{k}\t{t}\t{u}\t{i}\t{w}\t..........."
DIGATRON_ROW = "{d:%m/%d/%Y %I:%M:%S %p},3,CHA,06:18:{c},00:00:{c},Char,{u},{i},{w},"
EASYLOG = "EasyLog,Time,u(V),i(A),w(rad/s),Serial\n"
MARK = "MARK 001 - Manual - Sun Nov 22\n"
RECORD = "Index,u,i,w,Date,Time,Fractional Seconds\n"
ENERGY_PLUS = "Date/Time,u [V](Hourly),i [A](Hourly),w [rad/s](Hourly)\n"
TABLES = {
    "HOBO": ("a.csv", HOBO, "{n},{d:%m/%d/%y %H:%M:%S.%f},{u},{i},{w},", "121,11/22/26 10:30:02.0,,,,Logged\n"),
    "MoTeC": ("a.csv", MOTEC, '"{t}","{u}","{i}","{w}"'),
    "AiM": ("a.csv", AIM, "{t},{u},{i},{w}"),
    "HP Tuners": ("a.csv", HP_TUNERS, "{t},{u},{i},{w}"),
    "VCDS": ("a.csv", VCDS, ",{t},{u},{t},{i},{t},{w}"),
    "Digatron": ("a.csv", DIGATRON, DIGATRON_ROW),
    "Keithley": ("a.csv", RECORD, "{n},{u},{i},{w},{d:%m/%d/%Y},{d:%H:%M:%S},{f:.9f}"),
    "log of a controller": (
        "a.csv", "Record,Date,UTC Time,u,i,w\n", "{n},{d:%m/%d/%Y},{d:%H:%M:%S.%f},{u},{i},{w}", "//END,,,,,\n",
    ),
    "Victron": ("a.csv", VICTRON, '"{d:%Y-%m-%d %H:%M:%S.%f}","{u}","{i}","{w}"'),
    "EnergyPlus": ("a.csv", ENERGY_PLUS, " {d:%m/%d  %H:%M:%S.%f},{u},{i},{w}"),
    "Fluent": ("a.out", FLUENT, "{n} {u} {i} {w} {t}"),
    "EasyLog": ("a.txt", EASYLOG, "{n},{d:%d/%m/%Y %H:%M:%S.%f},{u},{i},{w}"),
    "Grafana": ("a.csv", "Time,u,i,w\n", "{d:%Y-%m-%d %H:%M:%S.%f},{u} V,{ma} mA,{w} rad/s"),
    "missing: states of a historian": ("a.csv", "Timestamp,u,i,w\n", "{d:%d-%b-%y %H:%M:%S.%f},{u},{state},{w}"),
    "Rockwell": ("a.csv", TREND, "Data:,{d:%m/%d/%Y},{d:%H:%M:%S};{m:03d},{u},{i},{w}"),
    "INCA with types": ("a.ascii", INCA, "{t}\t{u}\t{i}\t{w}"),
    "names above dates": (
        "a.csv", "u,,i,,w,\n", ",".join(f"{{d:%d-%b-%y %H:%M:%S.%f}},{{{name}}}" for name in "uiw"),
    ),
    "JSON lines, nested": ("a.jsonl", "", '{{"ts": {t}, "u": {u}, "more": {{"i": {i}, "w": {w}}}}}'),
    "Yokogawa DL950": ("a.csv", DL950, ",{u},{i},{w}"),
    "Tinytag": ("a.csv", TINYTAG, "{n},{d:%Y-%m-%d %H:%M:%S.%f},{u} V,{i} A,{w} rad/s"),
    # --- other names ---
    "units beside values": ("a.csv", LUTRON, "{n},{d:%Y/%m/%d},{d:%H:%M:%S.%f},{u},Volt,{ma},mA,{w},rad/s"),
    # --- refused ---
    "three levels": ("a.csv", LEVELS, ",,{n},0:00:{c},{u},{i},{w}"),
    "minimum and maximum": ("a.csv", RECORDER, "{d:%Y/%m/%d},{d:%H:%M:%S.%f},0,{u},{u},{i},{i},{w},{w}"),
    "one curve": ("a.DTA", CURVE.format(1), CURVE_ROW),
    "another curve": ("a.DTA", CURVE.format(2), CURVE_ROW),
    "marks among samples": ("a.msl", "Time\tu\ti\tw\ns\tV\tA\trad/s\n", "{t}\t{u}\t{i}\t{w}"),
    "messages of a bus": ("a.asc", CAN, "   {t:.6f} 1  1A0   Rx   d 8 00 11 22 33 44 55 66 77"),
}  # fmt: skip
"""File name, head, format of a row and end, of each text with one line a row."""
SIGNALS = {
    "Car Scanner": ('"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";\n', '"{t}";"{name}";"{v}";"{unit}";"45.7";', False),
    "WinCC": (
        '"VarName";"TimeString";"VarValue";"Validity"\n', '"{name}";"{d:%d.%m.%Y %H:%M:%S.%f}";{v};1', False
    ),
    "InfluxDB": (
        INFLUX + ",result,table,_time,_value,_field\n", ",,{j},{d:%Y-%m-%dT%H:%M:%S.%f}Z,{v},{name}", True
    ),
    "Home Assistant": ("entity_id,state,last_changed\n", "{name},{v},{d:%Y-%m-%dT%H:%M:%S.%f}Z", True),
}  # fmt: skip
"""Head and format of a sample, and whether all of one signal follow each other."""


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each tool."""
    rows = fields(frame, dates)
    found = tables(rows, TABLES)
    for name, (head, form, by_signal) in SIGNALS.items():
        found[name] = ("a.csv", signals(rows, head, form, by_signal=by_signal))
    found["WinCC"] = ("a.csv", found["WinCC"][1] + '"$RT_COUNT$";360;;\n')
    head, first, more = found["EasyLog"][1].split("\n", 2)
    found["EasyLog"] = ("a.txt", f"{head}\n{first},01012345\n{more}")
    found["two curves"] = ("a.DTA", f"EXPLAIN\n{found.pop('one curve')[1]}{found.pop('another curve')[1]}")
    lines = found["marks among samples"][1].splitlines(keepends=True)
    found["marks among samples"] = ("a.msl", "".join((*lines[:60], MARK, *lines[60:])))
    nested = '{"status": "success", "data": [{"metric": "u", "values": [[0, "1"]]}]}'
    return found | {"JSON of nested lists": ("a.json", nested)}
