"""Sections of a study file as classes: a `StudySection`, or settings (`Settings`) of the package that uses them."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache, reduce
from operator import or_
from pathlib import Path
from textwrap import dedent
from types import UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.studies import value_kinds as kinds
from fmuid.studies.renamed_keys import renamed_key
from fmuid.studies.toml import quoted_key, show


@dataclass(frozen=True)
class SectionLocation:
    """Section or key of a study file, for messages and relative paths."""

    file: str = field(compare=False)
    folder: Path
    keys: tuple[str | int, ...] = ()

    def below(self, *keys: str | int) -> SectionLocation:
        """Return a location further down."""
        return SectionLocation(self.file, self.folder, (*self.keys, *keys))

    @property
    def name(self) -> str:
        """Name as in messages: ``model.components[1].fmu``."""
        parts = (f"[{each}]" if isinstance(each, int) else f".{quoted_key(each)}" for each in self.keys)
        return "".join(parts).lstrip(".")

    def __str__(self) -> str:
        return f"{self.file}: {self.name}".removesuffix(": ")

    def error(self, text: str) -> InputError:
        """Return an error on this section or key."""
        return InputError(f"{self}: {text}")

    @contextmanager
    def located(self, source: Path | None = None) -> Iterator[None]:
        """Begin errors with this location, and with the source of a value."""
        try:
            yield
        except InputError as error:
            raise self.error(str(error) if source is None else f"{source}: {error}") from None


class StudySection(BaseModel):
    """Section of a study file; its fields are the keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)
    _place: SectionLocation = PrivateAttr(default=SectionLocation("the study", Path()))

    @property
    def place(self) -> SectionLocation:
        """Location in the file."""
        return self._place

    def error(self, text: str, *keys: str) -> InputError:
        """Return an error on this section, or on a key of it."""
        return self._place.below(*keys).error(text)

    @classmethod
    def read(cls, data: object, place: SectionLocation) -> Self:
        """Return a checked section and those below it."""
        try:
            read = cls.model_validate(data, context=place)
        except ValidationError as error:
            raise _refusal(error, place) from None
        _put(read, place)
        return read

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        """Refuse renamed and unknown keys first, then missing ones."""
        known = keys_of(cls)
        if not isinstance(data, dict):
            raise kinds.refusal(f"must be a section, not {show(data)}.")
        for key in (each for each in data if each not in known):
            near = nearest(key, known) or f". Use one of {', '.join(known)}."
            raise kinds.refusal(renamed_key(key, known) or f"unknown key {key!r}{near}")
        for key, asked in known.items():
            if asked.is_required() and key not in data:
                raise kinds.refusal(f"missing key {key!r}: {asked.description}.")
        return data


@dataclass(frozen=True)
class Settings:
    """Annotation of a settings class that is a section; its model is built with the first section."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a validator of its keys."""
        if not isinstance(source, type):
            return handler.generate_schema(kind_of(source))

        def checked(data: Any, info: ValidationInfo) -> Any:
            keys = dict(section_of(source).model_validate(data, context=info.context))
            try:
                return source(**keys)
            except InputError as error:
                raise kinds.refusal(str(error)) from None

        said = {"pydantic_js_functions": [lambda _, inner: inner(section_of(source).__pydantic_core_schema__)]}
        return core_schema.with_info_plain_validator_function(checked, metadata=said)


@cache
def section_of(table: Any) -> type[StudySection]:
    """Return a settings class as a section; its fields with ``key=False`` are no keys."""
    if isinstance(table, type) and issubclass(table, StudySection):
        return table
    hints, texts, keys = get_type_hints(table, include_extras=True), _docstrings(table), dict[str, Any]()
    for each in (each for each in fields(table) if each.metadata.get("key", True)):
        default = each.default if each.default_factory is MISSING else each.default_factory()
        text = " ".join(texts[each.name].split()).rstrip(".")
        keys[each.name] = kind_of(hints[each.name]), Field(... if default is MISSING else default, description=text)
    made = create_model(table.__name__, __base__=StudySection, __doc__=table.__doc__, **keys)
    made.model_rebuild()
    return made


def entry(default: Any, meaning: str, example: Any = None, **more: Any) -> Any:
    """Return a field of a section; ``...`` as default for a required key."""
    return Field(default, description=meaning, examples=None if example is None else [example], **more)


# --- what a section says of itself ----------------------------------------------------------


@cache
def keys_of(table: Any) -> dict[str, FieldInfo]:
    """Return the keys of a section, with types and defaults."""
    return {each.alias or name: each for name, each in section_of(table).model_fields.items()}


def own_first(table: type) -> list[tuple[str, FieldInfo]]:
    """Return the keys of a section, inherited ones last."""
    own = table.__annotations__
    return sorted(keys_of(table).items(), key=lambda item: item[0] not in own and item[1].alias is None)


def summary(table: type) -> str:
    """Return the first paragraph of the docstring of a section."""
    return " ".join((table.__doc__ or "").partition("\n\n")[0].split())


@cache
def _docstrings(table: type) -> dict[str, str]:
    """Return the docstrings of the fields of a dataclass."""
    found: dict[str, str] = {}
    for each in reversed([each for each in table.__mro__ if is_dataclass(each)]):
        (tree,) = ast.parse(dedent(inspect.getsource(each))).body
        assert isinstance(tree, ast.ClassDef)
        for before, after in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
                found[ast.unparse(before.target)] = ast.literal_eval(after.value)
    return found


def _alternatives(type_: Any) -> list[Any]:
    """Return the types of a union, without restrictions."""
    if get_origin(type_) is Annotated:
        return _alternatives(get_args(type_)[0])
    if get_origin(type_) in (Union, UnionType):
        return [each for part in get_args(type_) for each in _alternatives(part)]
    return [type_]


def table_of(type_: Any) -> type | None:
    """Return the section class of a type, or of its list entries."""
    for each in _alternatives(type_):
        part = _alternatives(get_args(each)[0])[0] if get_origin(each) is list else each
        if isinstance(part, type) and (issubclass(part, StudySection) or is_dataclass(part)):
            return part
    return None


def only_tables(type_: Any) -> bool:
    """Return whether all values of a type are sections."""
    return all(table_of(each) is not None for each in _alternatives(type_) if each is not type(None))


def entries_of(type_: Any) -> Any:
    """Return the type of the entries of ``{ name = value }``, else None."""
    return next((get_args(each)[1] for each in _alternatives(type_) if get_origin(each) is dict), None)


def kind_of(type_: Any) -> Any:
    """Return a type of a settings class as pydantic checks it."""
    base, *limits = get_args(type_) if get_origin(type_) is Annotated else (type_,)
    if any(isinstance(each, kinds.ValueKind) for each in limits):
        return type_
    origin, inner = get_origin(base), get_args(base)
    if origin in (Union, UnionType):
        # samples one by one are for Python alone
        inner = tuple(each for each in inner if get_args(each) != (float,))
        parts = [kind_of(each) for each in inner if each is not type(None)]
        if is_dataclass(inner[0]) and len(parts) == 1:
            switched = BeforeValidator(_switched, json_schema_input_type=bool | parts[0])
            return Annotated[parts[0] | None, switched]
        return _either(parts) if len(parts) == len(inner) else _either(parts) | None
    if origin is Literal:
        return Annotated[str, kinds.one_of(inner)]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        entries: Any = dict.__class_getitem__((str, kind_of(inner[1])))
        noun = {str: "text", float: "number"}.get(inner[1], "number" if get_origin(inner[1]) is Annotated else "value")
        return Annotated[entries, kinds.Entries(f"{{ name = {noun} }}")]
    if isinstance(origin, type) and issubclass(origin, Sequence):
        some: Any = list.__class_getitem__(kind_of(inner[0])) if is_dataclass(inner[0]) else kinds.Names
        return Annotated[some, AfterValidator(tuple)] if origin is tuple else some
    if base in (int, float):
        return Annotated[base, *limits, Field(allow_inf_nan=False) if base is float else None, _number(base, limits)]
    if is_dataclass(base):
        return type_ if any(isinstance(each, Settings) for each in limits) else Annotated[type_, Settings()]
    return {bool: kinds.Flag, str: kinds.Text}.get(base, type_)


def _switched(value: Any) -> Any:
    """Return an optional section given as true or false."""
    return value if not isinstance(value, bool) else {} if value else None


def _either(parts: list[Any]) -> Any:
    """Return a union of types."""
    tables = [each for each in parts if get_origin(get_args(each)[0]) is dict]
    if len(parts) == 1:
        return parts[0]
    if tables:
        plain = _either([each for each in parts if each not in tables])
        return Annotated[plain | tables[0], kinds.BY_SHAPE]
    names = [next(meta.name for meta in get_args(each) if isinstance(meta, kinds.ValueKind)) for each in parts]
    return Annotated[reduce(or_, parts), kinds.ValueKind(" or ".join(names))]


def _number(base: type, limits: Sequence[Any]) -> kinds.ValueKind:
    """Return the kind of numbers within limits."""
    noun = "a whole number" if base is int else "a number"
    low = {name: getattr(each, name) for each in limits for name in ("gt", "ge", "lt") if hasattr(each, name)}
    if "lt" in low:
        between = f"between {low['gt']} and {low['lt']}" if "gt" in low else f"from {low['ge']} to below {low['lt']}"
        return kinds.ValueKind(f"{noun} {between}")
    if "gt" in low:
        return kinds.ValueKind(f"{noun} above {low['gt']}")
    if "ge" in low:
        return kinds.ValueKind(f"{noun}, {low['ge']} or above")
    return kinds.ValueKind(noun) if base is int else kinds.ValueKind("a finite number", kinds.wrong_finite)


def _put(value: object, place: SectionLocation) -> None:
    """Set the location of all sections below `value`."""
    if isinstance(value, StudySection):
        value._place = place
        for name, field in type(value).model_fields.items():
            _put(getattr(value, name), place.below(field.alias or name))
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _put(item, place.below(key))


def _refusal(error: ValidationError, place: SectionLocation) -> InputError:
    """Return the first error of pydantic as one of fmuid."""
    first = error.errors(include_url=False)[0]
    kind, tags = first["type"], (kinds.VALUE_TAG, kinds.TABLE_TAG)
    there = place.below(*(key for key in first["loc"] if key not in tags))
    if kind == kinds.REFUSAL:
        return there.error(first["ctx"]["text"])
    expected = {"dict_type": "a section", "list_type": f"a list of sections [[{there.name}]]"}.get(kind, first["msg"])
    expected = first["ctx"]["text"] if kind == kinds.MUST_BE else expected
    return there.error(f"must be {expected}, not {show(first['input'])}.")
