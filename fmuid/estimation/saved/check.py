"""Check of the types of values that a file has."""

from __future__ import annotations

from functools import cache
from typing import Any

from fmuid.files import ContentError
from fmuid.formatting import bounded

_PLACE_SHOWN = 100  # characters


def check_types(content: object, schema: type) -> None:
    """Check the types of the values of a file at all depths.

    Parameters
    ----------
    content : object
        What a JSON file has.
    schema : type
        A ``TypedDict``; other keys may hold anything.

    Raises
    ------
    ContentError
        If a value is of another type; names its place.
    """
    from pydantic import ValidationError  # imported already where a study is read

    try:
        _validator(schema).validate_python(content, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(each) for each in first["loc"]) or "it"
        raise ContentError(f"{bounded(place, _PLACE_SHOWN)}: {first['msg'].replace('Input', 'the value')}") from None


@cache
def _validator(schema: type) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(schema)
