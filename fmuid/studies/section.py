"""What a study file is described with: tables as pydantic models, kinds of values, and every refusal in one sentence.

A table is a class of `StudySection`, each of its fields a `word` with kind, default and meaning. Checking, the JSON
schema, the reference page and the template of ``fmuid init`` all come from there. A sentence names the file, the
table, the key and what was expected there.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Self, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    PrivateAttr,
    Tag,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fmuid.errors import InputError
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
class SectionLocation:
    """A table of a study file.

    Attributes
    ----------
    file : str
        The study file's name for messages.
    folder : Path
        Paths in the file are relative to it.
    keys : tuple of str and int
        The way to the table, empty for the file itself.
    """

    file: str = field(compare=False)
    folder: Path
    keys: tuple[str | int, ...] = ()

    def below(self, *keys: str | int) -> SectionLocation:
        """Return a place further down."""
        return SectionLocation(self.file, self.folder, (*self.keys, *keys))

    @property
    def name(self) -> str:
        """The table as messages write it, such as ``[model.components][1]``."""
        names = [each if re.fullmatch(r"[A-Za-z0-9_-]+", each) else json.dumps(each, ensure_ascii=False)
                 for each in self.keys if isinstance(each, str)]  # fmt: skip
        entry = f"[{self.keys[-1]}]" if self.keys and isinstance(self.keys[-1], int) else ""
        return f"[{'.'.join(names)}]{entry}" if names else "the file"

    def __str__(self) -> str:
        return f"{self.file}: {self.name}"

    def error(self, text: str) -> InputError:
        """Return an error whose sentence is this table followed by `text`."""
        return InputError(f"{self} {text}")

    def error_of(self, key: str, text: str) -> InputError:
        """Return an error whose sentence is a key of this table followed by `text`."""
        return InputError(f"{self.file}: {key} {text}") if not self.keys else self.error(f"{key} {text}")


class StudySection(BaseModel):
    """One table of a study file; its fields are the keys that it may have."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)
    _place: SectionLocation = PrivateAttr(default=SectionLocation("the study", Path()))

    @property
    def place(self) -> SectionLocation:
        """Where in the file this stands."""
        return self._place

    def error(self, text: str) -> InputError:
        """Return an error whose sentence is this table followed by `text`."""
        return self._place.error(text)

    @classmethod
    def read(cls, data: object, place: SectionLocation) -> Self:
        """Return the words of a table and of those below it.

        Raises
        ------
        InputError
            If a key is unknown, missing or of the wrong kind, or a file is not there.
        """
        try:
            read = cls.model_validate(data, context=place)
        except ValidationError as error:
            raise _refusal(error, place) from None
        _put(read, place)
        return read

    @classmethod
    def types(cls) -> dict[str, Any]:
        """Return the type of each key."""
        return {field.alias or name: field.annotation for name, field in cls.model_fields.items()}

    @classmethod
    def example_line(cls, key: str) -> str:
        """Return a line with an example of a key and its meaning, commented out where that is not the default."""
        field = cls.model_fields[key]
        (example,) = field.examples or [field.default]
        return f"{'' if example == field.default else '# '}{key} = {show(example)}  # {field.description}"

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        """Check the keys before their values: one that is misspelt explains another that is missing."""
        if not isinstance(data, dict):
            raise said_of_table(f"must be a table, not {show(data)}")
        known = {field.alias or name: field for name, field in cls.model_fields.items()}
        for key in data:
            if key not in known:
                near = nearest(key, known) or f"; its keys are {', '.join(known)}"
                raise said_of_table(f"has no key {key!r}{near}")
        for key, asked in known.items():
            if asked.is_required() and key not in data:
                raise said_of_table(f"needs the key {key!r}: {asked.description}")
        return data


def word(default: Any, meaning: str, example: Any = None, **more: Any) -> Any:
    """Return a field of a table.

    Parameters
    ----------
    default
        ``...`` for a key that must be there.
    meaning
        What it is for, in a phrase.
    example
        What the template of ``fmuid init`` shows; without one, it does not show the word.
    more
        As `pydantic.Field` takes it.
    """
    return Field(default, description=meaning, examples=None if example is None else [example], **more)


def _alternatives(type_: Any) -> list[Any]:
    """Return the types that a value may be of, without what restricts them."""
    if get_origin(type_) is Annotated:
        return _alternatives(get_args(type_)[0])
    if get_origin(type_) in (Union, UnionType):
        return [each for part in get_args(type_) for each in _alternatives(part)]
    return [type_]


def table_of(type_: Any) -> type[StudySection] | None:
    """Return the table that values of a type may be, or that the entries of their list are."""
    for each in _alternatives(type_):
        part = get_args(each)[0] if get_origin(each) is list else each
        if isinstance(part, type) and issubclass(part, StudySection):
            return part
    return None


def only_tables(type_: Any) -> bool:
    """Return whether values of a type are tables of `StudySection`, or lists of them, and nothing else."""
    return all(table_of(each) is not None for each in _alternatives(type_))


def entries_of(type_: Any) -> Any:
    """Return the type of the entries of a table of names, None where values of a type are no such tables."""
    return next((get_args(each)[1] for each in _alternatives(type_) if get_origin(each) is dict), None)


def _put(value: object, place: SectionLocation) -> None:
    """Tell all tables below `value` where they stand."""
    if isinstance(value, StudySection):
        value._place = place
        for name, field in type(value).model_fields.items():
            _put(getattr(value, name), place.below(field.alias or name))
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _put(item, place.below(key))


def _refusal(error: ValidationError, place: SectionLocation) -> InputError:
    """Return pydantic's first error as a sentence."""
    first = error.errors(include_url=False)[0]
    kind, there = first["type"], place.below(*(key for key in first["loc"] if key not in (VALUE_TAG, TABLE_TAG)))
    if kind == "dict_type":
        return there.error(f"must be a table, not {show(first['input'])}")
    text = first["ctx"]["text"] if kind in (MUST_BE, KEY, TABLE) else first["msg"]
    if kind == TABLE:
        return there.error(text)
    if kind == "list_type":
        text = f"a list of tables, each begun with [{there.name}]"
    table, key = SectionLocation(place.file, place.folder, there.keys[:-1]), str(there.keys[-1])
    return table.error_of(key, text if kind == KEY else f"must be {text}, not {show(first['input'])}")


# --- kinds of values --------------------------------------------------------------------


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


def one_of(words: Sequence[str], later: Sequence[str] = ()) -> Choice:
    """Return the kind of a text that is one of `words`; those in `later` are known but not built yet."""
    listed = " or ".join(f'"{each}"' for each in words)

    def of_wrong(value: Any) -> str:
        if isinstance(value, str) and value in later:
            return f"{listed} in this version"
        return listed + (nearest(value, words) if isinstance(value, str) else "")

    return Choice(listed, of_wrong, tuple(words))


def _wrong_finite(value: Any) -> str:
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
    assert isinstance(info.context, SectionLocation)
    path = info.context.folder / value
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
Finite = Annotated[float, Field(allow_inf_nan=False), ValueKind("a finite number", _wrong_finite)]
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
