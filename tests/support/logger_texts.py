"""The record of `tests.support.table_variants` as battery cyclers and data loggers write texts."""

from __future__ import annotations

import pandas as pd

from tests.support.text_rows import fields, tables

TOA5 = """"TOA5","rig","CR1000","1","CR1000.Std.16","CPU:rig.CR1","6524","Table"
"TIMESTAMP","RECORD","u","i","w"
"TS","RN","V","A","rad/s"
"","","Smp","Avg","Avg"
"""
BIOLOGIC = """EC-Lab ASCII FILE
Nb header lines : 6

Acquisition started on : 11/22/2026 10:30:00
Bandwidth           4                   4
mode\ttime/s\tstep time/s\tu/V\ti/A\tw\t
"""
MACCOR = """Today's Date:\t22 November 2026\tDate of Test:\t22 November 2026
Filename:\trig\tTester Channel:\t1
Rec#\tTestTime\tStepTime\tu\ti\tw\tState\tDPt Time\tAux #1\t Units\tAux #2\t Units
"""
GAMRY = """EXPLAIN
TAG\tCHRONOA
TITLE\tLABEL\trig\tTest &Identifier
CURVE\tTABLE\t120
\tPt\tT\tu\ti\tw\tOver
\t#\ts\tV\tA\trad/s\tbits
"""
NOVONIX = """[Summary]
Novonix UHPC data file
[End Protocol]
[Data]
Date and Time,Cycle Number,Run Time (h),Step Time (h),u (V),i (A),w
"""
PEC = """Request Year:,2026
Test:,25195
Test,Cell,Cell ID,Total Time (Hours in hh:mm:ss.xxx),Load On Time (Hours in hh:mm:ss.xxx),u (V),i (A),w
"""
NEWARE = "DataPoint,Step Type,Time,Cumulative Time,u(V),i(A),w\n"
ARBIN = "Data Point,Date Time,Test Time (s),Step Time (s),u (V),i (A),w\n"
APART = "Date,Time,u [V],i [A],w[rad/s]\n"


MACCOR_ROW = (
    "{k}\t  0d 00:00:{c}\t  0d 00:00:{again:05.2f}\t{u}\t{i}\t{w}\tR\t{d:%m/%d/%Y %H:%M:%S}\t2.1\t C  \t2.2\t C  "
)
TABLES = {
    "Campbell TOA5": ("a.dat", TOA5, '"{d:%Y-%m-%d %H:%M:%S.%f}",{k},{u},{i},{w}'),
    "BioLogic": ("a.mpt", BIOLOGIC, "1\t{t:.15E}\t{again:.15E}\t{u}\t{i}\t{w}"),
    "Arbin": ("a.csv", ARBIN, "{k},\t{d:%m/%d/%Y %H:%M:%S.%f},{t},{again},{u},{i},{w}"),
    "Maccor": ("a.txt", MACCOR, MACCOR_ROW),
    "Gamry": ("a.DTA", GAMRY, "\t{k}\t{t}\t{u}\t{i}\t{w}\t..........."),
    "Novonix": ("a.csv", NOVONIX, "{d:%Y-%m-%d %H:%M:%S},1,{h},0.1,{u},{i},{w}"),
    "PEC": ("a.csv", PEC, "25195,1,34_6,00:00:{c},00:00:{again:06.3f},{u},{i},{w}"),
    "Neware": ("a.csv", NEWARE, "{k},Rest,00:00:{again:06.3f},00:00:{c},{u},{i},{w}"),
    "date and time apart": ("a.csv", APART, "{d:%d.%m.%Y},{d:%H:%M:%S.%f},{u},{i},{w}"),
}


def texts(frame: pd.DataFrame, dates: pd.Series) -> dict[str, tuple[str, str]]:
    """Return file name and text of each logger."""
    return tables(fields(frame, dates), TABLES)
