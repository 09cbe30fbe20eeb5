"""Pickled values read without running them: PyTables stores lists, names and texts of pandas as pickles."""

from __future__ import annotations

import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


class PickleError(ValueError):
    """Bytes that are no pickle of plain values."""


@dataclass(eq=False)
class PickledObject:
    """An object that a pickle would build, by name only: it is neither imported nor built.

    Attributes
    ----------
    name : str
        Module and name of the class or function, such as ``datetime.timezone``.
    arguments : tuple
        Its arguments, empty before any are given.
    state : object
        What the pickle would set it to, None without.
    """

    name: str
    arguments: tuple[Any, ...] = ()
    state: Any = None


_MARK = object()
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_EMPTY: dict[str, Callable[[], Any]] = {"EMPTY_LIST": list, "EMPTY_TUPLE": tuple, "EMPTY_DICT": dict}
_LITERALS = (
    {"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"}
    | {"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"}
    | {"STRING", "BINSTRING", "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"}
)
_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


def plain_value(data: bytes) -> Any:
    """Return the value of a pickle; an object in it is a `PickledObject`.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    object
        None, numbers, texts, bytes, and lists, tuples and dictionaries of them.

    Raises
    ------
    PickleError
        If the bytes are no pickle, or need more than that.
    """
    machine = _Machine()
    try:
        for code, argument, _ in pickletools.genops(data):
            if code.name == "STOP":
                return machine.result()
            machine.step(code.name, argument)
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        raise PickleError(str(error)) from None
    raise PickleError("it has no end")


class _Machine:
    """The stack and memory that the codes of a pickle work on; no code calls or imports anything."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}

    def step(self, code: str, argument: Any) -> None:
        """Carry out one code."""
        if code in _LITERALS:
            self.stack.append(argument)
        elif code in _CONSTANTS:
            self.stack.append(_CONSTANTS[code])
        elif code in _EMPTY:
            self.stack.append(_EMPTY[code]())
        elif code == "MARK":
            self.stack.append(_MARK)
        elif code in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            self.memory[len(self.memory) if argument is None else argument] = self.stack[-1]
        elif code in ("GET", "BINGET", "LONG_BINGET"):
            self.stack.append(self.memory[argument])
        elif code not in ("PROTO", "FRAME"):
            self._build(code, argument)

    def result(self) -> Any:
        """Return the value on top."""
        return self._popped(1)[0]

    def _build(self, code: str, argument: Any) -> None:
        if code in ("TUPLE", "LIST"):
            self.stack.append(tuple(self._marked()) if code == "TUPLE" else self._marked())
        elif code in _SIZES:
            self.stack.append(tuple(self._popped(_SIZES[code])))
        elif code in ("APPEND", "APPENDS"):
            values = [self.stack.pop()] if code == "APPEND" else self._marked()
            self._top(list).extend(values)
        elif code in ("DICT", "SETITEM", "SETITEMS"):
            values = self._popped(2) if code == "SETITEM" else self._marked()
            if code == "DICT":
                self.stack.append({})
            self._top(dict).update(zip(values[::2], values[1::2], strict=True))
        elif code in ("GLOBAL", "STACK_GLOBAL"):
            words = argument.split(" ") if code == "GLOBAL" else self._popped(2)
            self.stack.append(PickledObject(".".join(words)))
        elif code == "REDUCE":
            arguments = tuple(self.stack.pop())
            self.stack.append(_called(self._popped(1, of=PickledObject)[0].name, arguments))
        elif code == "BUILD":
            state = self.stack.pop()
            self._top(PickledObject).state = state
        else:
            raise PickleError(f"it has the code {code}")

    def _marked(self) -> list[Any]:
        """Remove and return the values above the last mark."""
        values: list[Any] = []
        while (value := self.stack.pop()) is not _MARK:
            values.append(value)
        return values[::-1]

    def _popped(self, count: int, of: type = object) -> list[Any]:
        """Remove and return the last values."""
        values = self.stack[-count:]
        if len(values) < count or not all(isinstance(each, of) and each is not _MARK for each in values):
            raise PickleError("it lacks a value")
        del self.stack[-count:]
        return values

    def _top(self, kind: type) -> Any:
        if not isinstance(self.stack[-1], kind):
            raise PickleError("it changes a value of another kind")
        return self.stack[-1]


def _called(name: str, arguments: tuple[Any, ...]) -> PickledObject:
    """Return what a call would build; a method that old pickles look up by `getattr` is one by name."""
    if name in ("__builtin__.getattr", "builtins.getattr"):
        owner, attribute = arguments
        return PickledObject(f"{owner.name}.{attribute}")
    return PickledObject(name, arguments)
