"""The record of `tests.support.table_variants` as historians, vehicles, controllers and simulators write texts."""

from __future__ import annotations

import pandas as pd

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
STATES = {6: "I/O Timeout", 7: "Bad Input", 59: "Comm Fail"}


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each tool, of a record of time, u, i, w in steps of 10 ms."""
    rows: list[list[float]] = frame[["time", "u", "i", "w"]].to_numpy().tolist()
    units = {"u": "V", "i": "A", "w": "rad/s"}

    def table(head: str, form: str) -> str:
        """Return a text with one line a row."""
        return head + "".join(
            form.format(
                k=k,
                n=k + 1,
                t=t,
                f=t % 1,
                m=date.microsecond // 1000,
                c=f"{t:06.3f}",
                d=date,
                u=u,
                i=i,
                w=w,
                s=STATES.get(k, i),
                ma=1e3 * i,
            )
            + "\n"
            for k, ((t, u, i, w), date) in enumerate(zip(rows, dates, strict=True))
        )

    def signals(head: str, form: str, *, by_signal: bool = False) -> str:
        """Return a text with one line a sample of a signal."""
        found = [
            (j if by_signal else k, form.format(j=j, n=name, v=row[j + 1], unit=units[name], t=row[0], d=date))
            for k, (row, date) in enumerate(zip(rows, dates, strict=True))
            for j, name in enumerate(units)
        ]
        return head + "".join(f"{line}\n" for _, line in sorted(found, key=lambda each: each[0]))

    curve = "\t{k}\t{t}\t{u}\t{i}\t{w}\t..........."
    log = table("Time\tu\ti\tw\ns\tV\tA\trad/s\n", "{t}\t{u}\t{i}\t{w}").splitlines(keepends=True)
    notes = table("EasyLog,Time,u(V),i(A),w(rad/s),Serial\n", "{n},{d:%d/%m/%Y %H:%M:%S.%f},{u},{i},{w}").split("\n", 2)
    return {
        "HOBO": (
            "a.csv",
            table(HOBO, "{n},{d:%m/%d/%y %H:%M:%S.%f},{u},{i},{w},") + "121,11/22/26 10:30:02.0,,,,Logged\n",
        ),
        "MoTeC": ("a.csv", table(MOTEC, '"{t}","{u}","{i}","{w}"')),
        "AiM": ("a.csv", table(AIM, "{t},{u},{i},{w}")),
        "HP Tuners": ("a.csv", table(HP_TUNERS, "{t},{u},{i},{w}")),
        "VCDS": ("a.csv", table(VCDS, ",{t},{u},{t},{i},{t},{w}")),
        "Digatron": (
            "a.csv",
            table(DIGATRON, "{d:%m/%d/%Y %I:%M:%S %p},3,CHA,06:18:{c},00:00:{c},Char,{u},{i},{w},"),
        ),
        "Keithley": (
            "a.csv",
            table("Index,u,i,w,Date,Time,Fractional Seconds\n", "{n},{u},{i},{w},{d:%m/%d/%Y},{d:%H:%M:%S},{f:.9f}"),
        ),
        "log of a controller": (
            "a.csv",
            table("Record,Date,UTC Time,u,i,w\n", "{n},{d:%m/%d/%Y},{d:%H:%M:%S.%f},{u},{i},{w}") + "//END,,,,,\n",
        ),
        "Victron": ("a.csv", table(VICTRON, '"{d:%Y-%m-%d %H:%M:%S.%f}","{u}","{i}","{w}"')),
        "EnergyPlus": (
            "a.csv",
            table("Date/Time,u [V](Hourly),i [A](Hourly),w [rad/s](Hourly)\n", " {d:%m/%d  %H:%M:%S.%f},{u},{i},{w}"),
        ),
        "Fluent": ("a.out", table(FLUENT, "{n} {u} {i} {w} {t}")),
        "EasyLog": ("a.txt", "\n".join((notes[0], f"{notes[1]},01012345", notes[2]))),
        "Grafana": ("a.csv", table("Time,u,i,w\n", "{d:%Y-%m-%d %H:%M:%S.%f},{u} V,{ma} mA,{w} rad/s")),
        "Car Scanner": (
            "a.csv", signals('"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";\n', '"{t}";"{n}";"{v}";"{unit}";"45.7";'),
        ),
        "WinCC": (
            "a.csv",
            signals('"VarName";"TimeString";"VarValue";"Validity"\n', '"{n}";"{d:%d.%m.%Y %H:%M:%S.%f}";{v};1')
            + '"$RT_COUNT$";360;;\n',
        ),
        "InfluxDB": (
            "a.csv",
            signals(
                INFLUX + ",result,table,_time,_value,_field\n",
                ",,{j},{d:%Y-%m-%dT%H:%M:%S.%f}Z,{v},{n}",
                by_signal=True,
            ),
        ),
        "Home Assistant": (
            "a.csv",
            signals("entity_id,state,last_changed\n", "{n},{v},{d:%Y-%m-%dT%H:%M:%S.%f}Z", by_signal=True),
        ),
        "missing: states of a historian": (
            "a.csv", table("Timestamp,u,i,w\n", "{d:%d-%b-%y %H:%M:%S.%f},{u},{s},{w}"),
        ),
        "Rockwell": ("a.csv", table(TREND, "Data:,{d:%m/%d/%Y},{d:%H:%M:%S};{m:03d},{u},{i},{w}")),
        "INCA with types": ("a.ascii", table(INCA, "{t}\t{u}\t{i}\t{w}")),
        "names above dates": (
            "a.csv",
            table("u,,i,,w,\n", ",".join(f"{{d:%d-%b-%y %H:%M:%S.%f}},{{{name}}}" for name in "uiw")),
        ),
        "JSON lines, nested": ("a.jsonl", table("", '{{"ts": {t}, "u": {u}, "more": {{"i": {i}, "w": {w}}}}}')),
        "Yokogawa DL950": ("a.csv", table(DL950, ",{u},{i},{w}")),
        "Tinytag": ("a.csv", table(TINYTAG, "{n},{d:%Y-%m-%d %H:%M:%S.%f},{u} V,{i} A,{w} rad/s")),
        # --- other names ---
        "units beside values": (
            "a.csv", table(LUTRON, "{n},{d:%Y/%m/%d},{d:%H:%M:%S.%f},{u},Volt,{ma},mA,{w},rad/s"),
        ),
        # --- refused ---
        "JSON of nested lists": ("a.json", '{"status": "success", "data": [{"metric": "u", "values": [[0, "1"]]}]}'),
        "three levels": ("a.csv", table(LEVELS, ",,{n},0:00:{c},{u},{i},{w}")),
        "minimum and maximum": ("a.csv", table(RECORDER, "{d:%Y/%m/%d},{d:%H:%M:%S.%f},0,{u},{u},{i},{i},{w},{w}")),
        "two curves": ("a.DTA", "EXPLAIN\n" + table(CURVE.format(1), curve) + table(CURVE.format(2), curve)),
        "marks among samples": ("a.msl", "".join((*log[:60], "MARK 001 - Manual - Sun Nov 22\n", *log[60:]))),
        "messages of a bus": ("a.asc", table(CAN, "   {t:.6f} 1  1A0   Rx   d 8 00 11 22 33 44 55 66 77")),
    }  # fmt: skip
