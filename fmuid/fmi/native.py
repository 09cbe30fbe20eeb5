"""Calls of native functions at their addresses, and memory at its addresses, from compiled loops.

Inside the loops nothing is a numpy array: numba counts references to arrays at every call of a function, which would
cost more than the FMI calls themselves; and functions of arrays take long to compile. All is reached by address.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _drop_stale_code() -> None:
    """Delete cached code that was compiled from other sources than these.

    numba compares the file of a function alone with its cached code, not the files whose constants and functions went
    into it: after an update that leaves a file as it was, old code would run on a new layout of memory.
    """
    folder = Path(__file__).parent
    cache = folder / "__pycache__"
    stamps = [f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in sorted(folder.glob("*.py"))]
    now, marker = "\n".join(stamps), cache / "compiled-from.txt"
    try:
        if marker.is_file() and marker.read_text() == now:
            return
        for path in cache.glob("*.nb?"):
            path.unlink(missing_ok=True)
        marker.write_text(now)
    except OSError:
        return  # where nothing can be written, numba keeps its code elsewhere, below the path of this installation


_drop_stale_code()


def native_call(*arguments: Any) -> Any:
    """Return a compiled function (address, *arguments) -> fmi2Status that calls the address."""

    @intrinsic  # type: ignore[untyped-decorator]
    def call(typing_context: Any, address: Any, values: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            target, packed = given
            wanted = [context.get_value_type(argument) for argument in arguments]
            have = cgutils.unpack_tuple(builder, packed)
            cast = [context.cast(builder, v, t, w) for v, t, w in zip(have, signature.args[1], arguments, strict=True)]
            pointer = builder.inttoptr(target, ir.FunctionType(ir.IntType(32), wanted).as_pointer())
            return builder.call(pointer, cast)

        return types.int32(types.intp, values), generate

    return call


def memory(kind: Any) -> tuple[Any, Any]:
    """Return compiled functions load(address, index) and store(address, index, value) for one type."""

    def element(context: Any, builder: Any, address: Any, index: Any) -> Any:
        pointer = builder.inttoptr(address, context.get_value_type(kind).as_pointer())
        return builder.gep(pointer, [index])

    @intrinsic  # type: ignore[untyped-decorator]
    def load(typing_context: Any, address: Any, index: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            return builder.load(element(context, builder, *given))

        return kind(types.intp, types.intp), generate

    @intrinsic  # type: ignore[untyped-decorator]
    def store(typing_context: Any, address: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            builder.store(given[2], element(context, builder, *given[:2]))
            return context.get_dummy_value()

        return types.void(types.intp, types.intp, kind), generate

    return load, store


load_real, store_real = memory(types.float64)
load_word, store_word = memory(types.intp)
load_int32, store_int32 = memory(types.int32)

call_plain = native_call(types.intp)
"""Calls an FMI function that takes the instance alone."""
