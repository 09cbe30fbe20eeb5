"""What `fmuid compare` prints: a table of results beside each other, and what follows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmuid.formatting import fit_text, label
from fmuid.reports.console.layout import console, show_sentences, table_of

if TYPE_CHECKING:
    from fmuid.reports.comparisons import ComparisonFindings


def show_comparison(found: ComparisonFindings) -> None:
    """Print a table, a row for each result, and the sentences that follow."""
    frame = found.table
    heads = {"name": "result", "parameters": "k", "log_likelihood": "log-likelihood"}
    heads |= {"corrected_aic": "AIC", "corrected_bic": "BIC", "behind": "behind"}
    heads |= {f"rmse.{output}": label(f"RMSE {output}", unit) for output, unit in found.units.items()}
    heads |= {"fit": "fit"}
    shown = [name for name in heads if name in frame.columns]
    columns = {heads[name]: [_cell(name, each) for each in frame[name].tolist()] for name in shown}
    console().print(table_of("Results beside each other", columns, list(columns)[1:]))
    show_sentences(found.words)


def _cell(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if name == "fit":
        return fit_text(value)
    return f"{value:.1f}" if name in ("log_likelihood", "corrected_aic", "corrected_bic", "behind") else f"{value:.4g}"
