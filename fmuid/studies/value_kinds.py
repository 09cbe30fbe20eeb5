"""Kinds of values in a study file: checks, and names for messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args

from pydantic import AfterValidator, BeforeValidator, Field, GetCoreSchemaHandler, ValidationError, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fmuid.files import full, is_file, is_folder
from fmuid.formatting import nearest
from fmuid.studies.renamed_keys import renamed_value

# Text of an error: the expected kind of value, or a whole message.
MUST_BE, REFUSAL = "must_be", "refusal"
# Names of pydantic's branches for a value that may be a section.
VALUE_TAG, TABLE_TAG = "<value>", "<table>"


def must_be(expected: str) -> PydanticCustomError:
    """Return the error of a value that is not as `expected`."""
    return PydanticCustomError(MUST_BE, "{text}", {"text": expected})


def required(is_valid: Callable[[Any], bool], expected: str) -> AfterValidator:
    """Return a check that refuses other values by what is `expected`."""

    def checked(value: Any) -> Any:
        if not is_valid(value):
            raise must_be(expected)
        return value

    return AfterValidator(checked)


def refusal(text: str) -> PydanticCustomError:
    """Return an error with a whole message."""
    return PydanticCustomError(REFUSAL, "{text}", {"text": text})


@dataclass(frozen=True)
class ValueKind:
    """Name of the values of a type, last in its annotation; `of_wrong` may depend on the value."""

    name: str
    of_wrong: Callable[[Any], str] | None = None
    names_keys: ClassVar[bool] = False  # whether errors below a value are kept: they name a key

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the type's schema, with all errors as one."""
        return core_schema.no_info_wrap_validator_function(self._checked, handler(source))

    def _checked(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        try:
            return inner(value)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            if first["type"] in (MUST_BE, REFUSAL) and not first["loc"]:
                raise PydanticCustomError(first["type"], "{text}", first["ctx"]) from None
            if self.names_keys and first["loc"]:
                raise
            raise must_be(self.name if self.of_wrong is None else self.of_wrong(value)) from None


class Entries(ValueKind):
    """Kind of ``{ name = value }``; errors name the entry."""

    names_keys: ClassVar[bool] = True


@dataclass(frozen=True)
class Choice(ValueKind):
    """Kind of a text from some words; made by `one_of`."""

    words: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a literal's schema, with all errors as one."""
        return core_schema.no_info_wrap_validator_function(self._checked, core_schema.literal_schema(list(self.words)))

    def _checked(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        if text := renamed_value(value, self.words):
            raise refusal(text)
        return super()._checked(value, inner)


def one_of(words: Sequence[str]) -> Choice:
    """Return the kind of a text that is one of `words`."""
    listed = " or ".join(f'"{each}"' for each in words)

    def of_wrong(value: Any) -> str:
        return listed + (nearest(value, words) if isinstance(value, str) else "")

    return Choice(listed, of_wrong, tuple(words))


def wrong_finite(value: Any) -> str:
    """Return the expected kind of a finite number."""
    return "a finite number" if isinstance(value, float) else "a number"


ROWS = "a list of rows of numbers, [[4.0, 0.1], [0.1, 2.0]]"


def _once(value: list[str]) -> list[str]:
    for name in value:
        if value.count(name) > 1:
            raise must_be(f"a list with each name once ({name!r} is there twice)")
    return value


def _columns(value: Any) -> Any:
    """Return a list of names as a mapping of names to columns."""
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return {name: name for name in _once(value)}
    return value


def as_list(value: Any) -> Any:
    """Return a text as a list of it, all else unchanged."""
    return [value] if isinstance(value, str) else value


def existing_file(value: object, info: ValidationInfo) -> Path:
    """Return the path of an existing file, relative to the study file."""
    if not isinstance(value, str) or not value:
        raise must_be("a text in quotes")
    assert info.context is not None, "the section's location"
    path: Path = info.context.folder / value
    if not is_file(path):
        there = "is a folder. Name a file in it" if is_folder(path) else "not found"
        raise refusal(f"file {full(path)} {there}.")
    return path


@dataclass(frozen=True)
class ByShape:
    """Annotation of a union whose last type is known by its shape."""

    shape: type = dict

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a union that looks at the shape alone."""
        *values, table = get_args(source)
        branches = {VALUE_TAG: handler.generate_schema(reduce(or_, values)), TABLE_TAG: handler.generate_schema(table)}
        return core_schema.tagged_union_schema(
            branches, discriminator=lambda value: TABLE_TAG if isinstance(value, self.shape) else VALUE_TAG
        )


BY_SHAPE = ByShape()
Text = Annotated[str, Field(min_length=1), ValueKind("a text in quotes")]
Flag = Annotated[bool, ValueKind("true or false")]
Number = Annotated[float, required(lambda value: not math.isnan(value), "a number"), ValueKind("a number")]
Finite = Annotated[float, Field(allow_inf_nan=False), ValueKind("a finite number", wrong_finite)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), ValueKind("a number above 0")]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), ValueKind("a number, 0 or above")]
Share = Annotated[float, Field(gt=0, lt=1), ValueKind("a number between 0 and 1")]
Count = Annotated[int, Field(gt=0), ValueKind("a whole number above 0")]
Natural = Annotated[int, Field(ge=0), ValueKind("a whole number, 0 or above")]
Scalar = Annotated[bool | int | float | str, ValueKind("a number, true, false or a text")]
Numbers = Annotated[list[Finite], ValueKind("a list of numbers")]
Matrix = Annotated[
    list[Numbers],
    Field(min_length=1),
    required(lambda rows: len({len(row) for row in rows}) == 1, ROWS),
    ValueKind(ROWS),
]
Names = Annotated[list[Text], Field(min_length=1), ValueKind('a list of names, ["Rs", "Rr"]'), AfterValidator(_once)]
Columns = Annotated[
    dict[str, Text],
    BeforeValidator(_columns, json_schema_input_type=list[str] | dict[str, str]),
    ValueKind('a list of names, ["u", "w"], or { fmu_variable = "column" }'),
]
NAME_OR_PLACE = "a name, or a place from 1"
NameOrPlace = Annotated[
    str | int,
    required(
        lambda given: bool(given) and not isinstance(given, bool) and (isinstance(given, str) or given > 0),
        NAME_OR_PLACE,
    ),
    ValueKind(NAME_OR_PLACE),
]
Marks = Annotated[list[Text | Finite], ValueKind('a list of texts and numbers, ["OL", -9999]')]
Texts = Annotated[dict[str, Text], Entries("{ name = text }")]
Scalars = Annotated[dict[str, Scalar], Entries("{ name = value }")]
Finites = Annotated[dict[str, Finite], Entries("{ name = number }")]
Positives = Annotated[dict[str, Positive], Entries("{ name = number }")]
PositiveOrEach = Annotated[Positive | Positives, BY_SHAPE]
FILES = BeforeValidator(
    required(lambda value: isinstance(value, list), "a list of files").func, json_schema_input_type=list[str]
)
File = Annotated[Path, BeforeValidator(existing_file, json_schema_input_type=str), ValueKind("the path of a file")]
Files = Annotated[list[File], FILES]
SEGMENTS = "a list of pairs of times, [[0.0, 1.5], [2.0, 3.5]]"
Segments = Annotated[
    list[Annotated[list[Finite], Field(min_length=2, max_length=2)]],
    ValueKind(SEGMENTS),
    required(lambda segments: all(begin < end for begin, end in segments), f"{SEGMENTS}, earlier time first"),
]
