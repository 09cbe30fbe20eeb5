"""Results made up for tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def result(folder: Path, values: dict[str, tuple[float, float | None]], **changes: Any) -> Path:
    """Write a result.json with these values and standard deviations, and return its path."""
    variances = [None if std is None else std**2 for _, std in values.values()]
    content = {
        "outcome": "converged",
        "converged": True,
        "parameters": {name: {"value": v, "std": std, "start": 1.0} for name, (v, std) in values.items()},
        "covariance": {
            "names": list(values),
            "matrix": [[v if i == j else 0.0 for j in range(len(variances))] for i, v in enumerate(variances)],
        },
        "noise_variance": {"i": 1.0},
        "criterion": 1.0,
        "iterations": 3,
        "simulations": 9,
        "elapsed_s": 0.1,
        "version": "0",
        "models": {"": {"name": "Coil", "digest": "0"}},
    }
    path = folder / "result.json"
    path.write_text(json.dumps(content | changes))
    return path
