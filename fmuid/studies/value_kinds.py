"""Kinds of values in a study file: how each is checked, and what a sentence calls it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    Tag,
    ValidationError,
    ValidationInfo,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fmuid.files import full, is_file
from fmuid.formatting import nearest
from fmuid.studies.toml import show

# What the text of an error follows in its sentence: "[table] key must be", "[table] key", "[table]".
MUST_BE, KEY, TABLE = "must_be", "key", "table"
# Where a value may be a table or not, pydantic names the branch it took.
VALUE_TAG, TABLE_TAG = "<value>", "<table>"


def must_be(expected: str) -> PydanticCustomError:
    """Return the error of a value that is not what is `expected`."""
    return PydanticCustomError(MUST_BE, "{text}", {"text": expected})


def said_of_table(text: str) -> PydanticCustomError:
    """Return the error whose sentence is a table followed by `text`; to be raised by a check of the whole table."""
    return PydanticCustomError(TABLE, "{text}", {"text": text})


@dataclass(frozen=True)
class ValueKind:
    """What values of a type are called; in the annotation of the type, after all that restricts it.

    Attributes
    ----------
    name : str
    of_wrong : callable, optional
        Gives for a wrong value what was expected, where that depends on it.
    """

    name: str
    of_wrong: Callable[[Any], str] | None = None
    names_keys: ClassVar[bool] = False
    """Whether an error below a value is left as it is, which names a key and not the value."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return what the type is, with all its errors as one."""
        return core_schema.no_info_wrap_validator_function(self._checked, handler(source))

    def _checked(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        try:
            return inner(value)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            if first["type"] in (MUST_BE, KEY) and not first["loc"]:
                raise PydanticCustomError(first["type"], "{text}", first["ctx"]) from None
            if self.names_keys and first["loc"]:
                raise
            raise must_be(self.name if self.of_wrong is None else self.of_wrong(value)) from None


class Entries(ValueKind):
    """The kind of a table of names whose entries are of one kind; what is wrong with one names it."""

    names_keys: ClassVar[bool] = True


@dataclass(frozen=True)
class Choice(ValueKind):
    """The kind of a text that is one of some words; `one_of` makes it."""

    words: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the words, with all errors as one."""
        return core_schema.no_info_wrap_validator_function(self._checked, core_schema.literal_schema(list(self.words)))


def one_of(words: Sequence[str]) -> Choice:
    """Return the kind of a text that is one of `words`."""
    listed = " or ".join(f'"{each}"' for each in words)

    def of_wrong(value: Any) -> str:
        return listed + (nearest(value, words) if isinstance(value, str) else "")

    return Choice(listed, of_wrong, tuple(words))


def wrong_finite(value: Any) -> str:
    """Return what a number that is none, or not finite, should be."""
    return "a finite number" if isinstance(value, float) else "a number"


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise must_be("a number")
    return value


ROWS = "a list of rows of numbers, [[4.0, 0.1], [0.1, 2.0]]"


def _rows(value: list[list[float]]) -> list[list[float]]:
    if len({len(row) for row in value}) != 1:
        raise must_be(ROWS)
    return value


def _once(value: list[str]) -> list[str]:
    """Check that each name is there once."""
    for name in value:
        if value.count(name) > 1:
            raise must_be(f"a list that names each variable once ({name!r} is there twice)")
    return value


def _columns(value: Any) -> Any:
    """Return a list of names as a table of names and columns."""
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return {name: name for name in _once(value)}
    return value


def _named_or_placed(value: str | int) -> str | int:
    if isinstance(value, bool) or not value or (isinstance(value, int) and value < 1):
        raise must_be("a name, or a place from 1")
    return value


def as_list(value: Any) -> Any:
    """Return one text as a list of it, and what else is there as it is."""
    return [value] if isinstance(value, str) else value


def _listed_files(value: Any) -> Any:
    if not isinstance(value, list):
        raise must_be("a list of paths of files")
    return value


def existing_file(value: object, info: ValidationInfo) -> Path:
    """Return the path of a file that must be there, relative to the study file."""
    if not isinstance(value, str) or not value:
        raise must_be("a text in quotes")
    assert info.context is not None, "the section's location"
    path: Path = info.context.folder / value
    if not is_file(path):
        raise PydanticCustomError(KEY, "{text}", {"text": f"= {show(value)}: there is no file {full(path)}"})
    return path


def _shape(value: object) -> str:
    return TABLE_TAG if isinstance(value, dict) else VALUE_TAG


BY_SHAPE = Discriminator(_shape)
"""Of a value or a table, tagged as `VALUE_TAG` and `TABLE_TAG`."""
Text = Annotated[str, Field(min_length=1), ValueKind("a text in quotes")]
Flag = Annotated[bool, ValueKind("true or false")]
Number = Annotated[float, AfterValidator(_not_nan), ValueKind("a number")]
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
    AfterValidator(_rows),
    ValueKind(ROWS),
]
Names = Annotated[list[Text], Field(min_length=1), ValueKind('a list of names, ["Rs", "Rr"]'), AfterValidator(_once)]
Columns = Annotated[
    dict[str, Text],
    BeforeValidator(_columns, json_schema_input_type=list[str] | dict[str, str]),
    ValueKind('a list of names, ["u", "w"], or a table { fmu_variable = "column" }'),
]
NameOrPlace = Annotated[str | int, AfterValidator(_named_or_placed), ValueKind("a name, or a place from 1")]
Texts = Annotated[dict[str, Text], Entries("a table { name = text }")]
Scalars = Annotated[dict[str, Scalar], Entries("a table { name = value }")]
Finites = Annotated[dict[str, Finite], Entries("a table { name = number }")]
Positives = Annotated[dict[str, Positive], Entries("a table { name = number }")]
PositiveOrEach = Annotated[Annotated[Positive, Tag(VALUE_TAG)] | Annotated[Positives, Tag(TABLE_TAG)], BY_SHAPE]
File = Annotated[Path, BeforeValidator(existing_file, json_schema_input_type=str), ValueKind("the path of a file")]
Files = Annotated[list[File], BeforeValidator(_listed_files, json_schema_input_type=list[str])]
SEGMENTS = "a list of pairs of times, [[0.0, 1.5], [2.0, 3.5]]"


def _forwards(segments: list[list[float]]) -> list[list[float]]:
    if any(end <= begin for begin, end in segments):
        raise must_be(f"{SEGMENTS}, each with the earlier time first")
    return segments


Segments = Annotated[
    list[Annotated[list[Finite], Field(min_length=2, max_length=2)]], ValueKind(SEGMENTS), AfterValidator(_forwards)
]
