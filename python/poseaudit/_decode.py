"""Decodes JSON into dataclasses by their annotations. Ignores unknown keys, which a later version
may have added."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from ._errors import ReportError
from ._frame import Rows

T = TypeVar("T")


def decode(kind: type[T], value: object, place: str) -> T:
    """Decodes `value` as a `kind`. `place` is its path for error messages."""
    return typing.cast(T, _decode(kind, value, place))


def _decode(kind: Any, value: object, place: str) -> object:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return None if value is None else _decode(_non_none(inner), value, place)
    if origin is Rows:
        return Rows(inner[0], _list(inner[0], value, place), typing.cast(Any, value))
    if origin is tuple:
        rows = _list(inner[0], value, place)
        if inner[-1] is not Ellipsis and len(rows) != len(inner):
            raise _unexpected(place, f"{len(inner)} values", value)
        return tuple(rows)
    if dataclasses.is_dataclass(kind):
        return _object(kind, value, place)
    if origin is not None:
        kind = dict
    return _scalar(kind, value, place)


def _scalar(kind: Any, value: object, place: str) -> object:
    if kind is Any:
        return value
    if kind is int and isinstance(value, str) and value.removeprefix("-").isdecimal():
        return int(value)  # nanoseconds, which exceed JSON numbers
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    raise _unexpected(place, kind.__name__, value)


def _list(kind: Any, value: object, place: str) -> list[object]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise _unexpected(place, "a list", value)
    return [_decode(kind, one, f"{place}[{index}]") for index, one in enumerate(value)]


def _object(kind: Any, value: object, place: str) -> object:
    if not isinstance(value, Mapping):
        raise _unexpected(place, "an object", value)
    types_of = _types(kind)
    values: dict[str, object] = {}
    for field in dataclasses.fields(kind):
        key = field.name.removesuffix("_")  # `is` is a Python keyword
        if key in value:
            values[field.name] = _decode(types_of[field.name], value[key], f"{place}.{key}")
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise ReportError(f"{place}: it has no {key!r}; write the report again with this version")
    return kind(**values)


@functools.cache
def _types(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _non_none(inner: tuple[Any, ...]) -> Any:
    (kind,) = (kind for kind in inner if kind is not types.NoneType)
    return kind


def _unexpected(place: str, expected: str, value: object) -> ReportError:
    found = repr(value)
    found = found if len(found) <= 40 else found[:37] + "…"
    return ReportError(
        f"{place}: expected {expected}, found {found}; write the report again with this version"
    )
