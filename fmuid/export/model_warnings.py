"""Warnings about probable mistakes in a model that can be exported."""

from __future__ import annotations

import casadi as ca

from fmuid.errors import ModelicaWarning
from fmuid.export.explicit_model import ExplicitModel


def remarks(system: ExplicitModel) -> list[ModelicaWarning]:
    """Return warnings for the author of a model: parameters without effect, no chosen integration step."""
    model = system.model
    computed = system.plain(ca.vertcat(system.derivatives, system.algebraic, system.indicators))
    used = {symbol.name() for symbol in ca.symvar(ca.vertcat(computed, system.starts))}
    found = [
        ModelicaWarning(model.file, each.line, f"parameter '{each.name}' is used nowhere: use or remove it")
        for each in system.parameters
        if each.name not in used
    ]
    if model.interval is None:
        text = f"experiment without Interval: co-simulation takes steps of {model.step:g} s, without error control"
        found.append(ModelicaWarning(model.file, model.last_line, f"{text}; give the step that the model needs"))
    return found
