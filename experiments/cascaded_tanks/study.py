"""Cascaded tanks, a public benchmark: three models of a record, and the choice between them on one that none has seen.

    python -m experiments.cascaded_tanks.study dataBenchmark.csv [FOLDER]

Run from the project's folder, with the extra "export": it exports the model, writes studies, tables and results into
the folder (default: a temporary one), prints what `fmuid compare` says, and rewrites the table in README.md beside it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pandas as pd

import fmuid
from experiments import pages
from fmuid.export import export_fmu
from fmuid.reports.documents import document
from fmuid.runs import compared as compare_results

HERE = Path(__file__).parent

STUDY = """
[model]
fmu = "CascadedTanks.fmu"
fixed = {{ {values} }}
[[experiments]]
data = "first.csv"
inputs = ["u"]
outputs = ["y"]
interpolation = "zoh"
[estimation]
model_error = "report"
[parameters]
k = {{ start = 0.04, min = 1e-4 }}
u0 = {{ start = 0.5, nominal = 1.0, min = 0.0 }}
a1 = {{ start = 0.045, min = 1e-4 }}
a2 = {{ start = 0.04, min = 1e-4 }}
x1_start = {{ start = 5.0, min = 0.0 }}
x2_start = {{ start = 5.2, min = 0.0 }}
"""
OVERFLOW = """top1 = { start = 10.0, min = 3.0, max = 30.0 }
share = { start = 0.5, min = 0.0, max = 1.0 }
over = { start = 0.2, min = 0.01, max = 2.0 }
"""
LOWER_RIM = "top2 = 10.0"  # V, where the sensor ends too
MODELS = {
    "linear": STUDY.format(values="p = 1.0"),
    "bernoulli": STUDY.format(values=""),
    "overflow": STUDY.format(values=LOWER_RIM) + OVERFLOW,
}


def write_tables(data: Path, folder: Path) -> None:
    """Write both records, the one to identify from and the one to predict."""
    given = pd.read_csv(data)
    times = float(given["Ts"].iloc[0]) * pd.Series(range(len(given)))
    for name, suffix in (("first", "Est"), ("second", "Val")):
        record = pd.DataFrame({"time": times, "u": given[f"u{suffix}"], "y": given[f"y{suffix}"]})
        record.to_csv(folder / f"{name}.csv", index=False)


def table(folder: Path) -> str:
    """Identify all models, compare them, and return the table of the page."""
    for name, text in MODELS.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        found = fmuid.run(folder / f"{name}.toml", folder / name)
        print(name, fmuid.Document.of(found.result), found.result.to_frame(), sep="\n")
    compared = compare_results([folder / name for name in MODELS], [folder / "second.csv"])
    print(compared.table, *(each.text for each in document(compared).remarks), sep="\n")
    rows = compared.table.set_index("name")
    lines = []
    for name in MODELS:
        result = fmuid.Result.from_json(folder / name / "result.json")
        count = result.setup.data[0].samples
        first = (result.fit.noise_variance["y"] * result.fit.degrees_of_freedom / count) ** 0.5
        row = rows.loc[name]
        numbers = f"{row['parameters']:.0f}", f"{first:.3f} V", f"{row['behind']:.0f}", f"{row['rmse.y']:.3f} V"
        lines.append((name, *numbers))
    heads = ["model", "k", "RMSE of the first record", "AIC behind", "RMSE of the second record"]
    return pages.table(heads, lines)


def main(data: Path, folder: Path) -> None:
    """Run all of it in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    export_fmu(HERE / "CascadedTanks.mo", folder / "CascadedTanks.fmu")
    write_tables(data, folder)
    pages.rewrite(HERE, {"models": table(folder)})


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else Path(temporary))
