"""C code of the equations: `model.h` of the FMU's sources."""

from __future__ import annotations

import json
from typing import Any

import casadi as ca

from fmuid.export.explicit_model import ExplicitModel, column

_OF_ONE = {ca.OP_SQRT: "sqrt", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TANH: "tanh", ca.OP_FABS: "fabs"}
_OF_TWO = {ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax"}
_FORMATS = {
    **{operation: name + "({})" for operation, name in _OF_ONE.items()},
    **{operation: name + "({}, {})" for operation, name in _OF_TWO.items()},
    ca.OP_FLOOR: "floor({})",
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_NEG: "-{}",
    ca.OP_TWICE: "2.0 * {}",
    ca.OP_SQ: "{0} * {0}",
    # From derivatives of powers to their exponents alone, log(a) * a^b: 0 where a is 0, without meaning where a < 0.
    ca.OP_LOG: "{0} > 0.0 ? log({0}) : 0.0",
    ca.OP_SIGN: "{0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : {0}",
    ca.OP_LT: "(double)({} < {})",
    ca.OP_LE: "(double)({} <= {})",
    ca.OP_NOT: "(double)!{}",
    ca.OP_AND: "(double)({} && {})",
    ca.OP_OR: "(double)({} || {})",
    ca.OP_IF_ELSE_ZERO: "{} ? {} : 0.0",
}


def header(system: ExplicitModel, guid: str) -> str:
    """Return the text of `model.h`, the same for the same model."""
    model, x, u, p, t, r = system.model, system.x, system.u, system.p, system.t, system.r
    number = system.numbers.get
    values = [
        *(number((each.name, "start"), 0.0) for each in system.inputs),
        *(number((each.name, "value"), 0.0) for each in system.parameters),
    ]
    nominals = [number((each.name, "nominal"), 1.0) for each in system.states]
    names = ", ".join(f'"{name}"' for name in system.names())
    events = [("relation", each) for each in system.relations]
    events += [("jump of", each) for each in system.integers for _ in ("up", "down")]
    jumps = ", ".join(json.dumps(f"{kind} {each.text} (line {each.line})") for kind, each in events)
    rates, others, indicators, symbols, cached = _hoist(system)
    seeds = [ca.SX.sym(name, each.numel()) for name, each in (("xd", x), ("ud", u), ("pd", p))]
    unknowns = system.plain(ca.vertcat(system.derivatives, system.algebraic, system.indicators))
    unknowns_seed = ca.densify(ca.jtimes(unknowns, ca.vertcat(x, u, p), ca.vertcat(*seeds)))
    rates_seed, others_seed, indicators_seed = _split(system, unknowns_seed)
    # The rest is shared by all directions at one point.
    rates_seed, shared, common = ca.extract_parametric(ca.cse(rates_seed), ca.vertcat(x, u, p, t, r))
    rates_seed, shared, common = ca.densify(rates_seed), column(shared), column(common)
    sizes = {"NX": x, "NU": u, "NP": p, "NW": others, "NC": symbols, "ND": shared}
    starts_seed = ca.densify(ca.jtimes(system.starts, p, seeds[2]))
    point = {"x": x, "u": u, "p": p, "t": t, "r": r}
    directions = dict(zip(("xd", "ud", "pd"), seeds, strict=True))
    return "\n".join(
        [
            f"/* {model.name}, generated: x states, u inputs, p parameters, w other variables, dx = dx/dt, t time,",
            "   r NR relations (0 or 1: an event sets r to z > 0), then NI whole numbers floor(a) (an event sets r so",
            "   that its two z are r + 1 - a > 0 and r - a <= 0), z event indicators, c subexpressions of p alone;",
            "   names that end in d: derivatives along a direction of x, u, p; e what those of dx share along all */",
            "#include <math.h>",
            f'#define MODEL_GUID "{guid}"',
            f"#define MODEL_STEP {model.step!r} /* largest internal step of the co-simulation, s */",
            f"enum {{ {', '.join(f'{name} = {each.numel()}' for name, each in sizes.items())},",
            f"       NR = {len(system.relations)}, NI = {len(system.integers)} }};",
            f"static const char *const model_names[] = {{{names}}};",
            f"static const char *const model_jumps[] = {{{jumps or 'NULL'}}}; /* z */",
            f"static const double model_values[] = {{{_numbers(values)}}}; /* u, p */",
            f"static const double model_nominals[] = {{{_numbers(nominals)}}}; /* x */",
            _function("model_cache", {"p": p}, {"c": cached}),
            _function("model_starts", {"p": p}, {"x": ca.densify(system.starts)}),
            _function("model_derivatives", point | {"c": symbols}, {"dx": rates}),
            _function("model_evaluate", point | {"c": symbols}, {"dx": rates, "w": others}),
            _function("model_indicators", point | {"c": symbols}, {"z": indicators}),
            _function("model_starts_seed", {"p": p, "pd": seeds[2]}, {"xd": starts_seed}),
            _function("model_point", point, {"e": common}),
            _function("model_rates_seed", point | {"e": shared} | directions, {"dxd": rates_seed}),
            _function("model_others_seed", point | directions, {"wd": others_seed, "zd": indicators_seed}),
            "",
        ]
    )


def _numbers(values: list[float]) -> str:
    return ", ".join(map(repr, values)) or "0.0"  # C wants at least one


def _hoist(system: ExplicitModel) -> tuple[Any, Any, Any, Any, Any]:
    """Return derivatives, other variables and indicators with symbols c; these symbols and their values of p alone."""
    reciprocals = column(symbol for symbol, _ in system.reciprocals)
    unknowns = ca.cse(ca.vertcat(system.derivatives, system.algebraic, system.indicators))
    unknowns, symbols, values = ca.extract_parametric(unknowns, ca.vertcat(system.p, reciprocals))
    cached = column([*(value for _, value in system.reciprocals), *map(system.plain, values)])
    return *_split(system, ca.densify(unknowns)), column([reciprocals, *symbols]), cached


def _split(system: ExplicitModel, unknowns: Any) -> tuple[Any, Any, Any]:
    """Return the derivatives, other variables and event indicators of a column."""
    first, second = system.x.numel(), system.x.numel() + len(system.others)
    rates, others, indicators = ca.vertsplit(unknowns, [0, first, second, unknowns.numel()])
    return rates, others, indicators


def _function(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> str:
    """Return a C function of the expressions, one constant per intermediate result."""
    f = ca.Function(name, [*inputs.values()], ca.cse([*outputs.values()]))
    read, written = [*inputs], [*outputs]
    lines, at = [], {}  # place in CasADi's work vector -> C expression of its present content
    for k in range(f.n_instructions()):
        operation, places, sources = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if operation == ca.OP_CONST:
            at[places[0]] = f"({f.instruction_constant(k)!r})"
        elif operation == ca.OP_INPUT:
            at[places[0]] = f"{read[sources[0]]}[{sources[1]}]"
        elif operation == ca.OP_OUTPUT:
            lines.append(f"  {written[places[0]]}[{places[1]}] = {at[sources[0]]};")
        else:
            lines.append(f"  const double t{k} = {_FORMATS[operation].format(*(at[s] for s in sources))};")
            at[places[0]] = f"t{k}"
    arguments = [*(f"const double *{each}" for each in read), *(f"double *{each}" for each in written)]
    unused = [f"  (void){each};" for each in [*read, *written] if not any(f"{each}[" in line for line in lines)]
    return "\n".join([f"static inline void {name}({', '.join(arguments)}) {{", *unused, *lines, "}"])
