"""Dataclasses to plain JSON values and back, by their types: results that are stored are data, never code."""

from __future__ import annotations

import base64
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

ARRAY_TYPES = frozenset({"float64", "int64", "bool"})


class PlainError(ValueError):
    """A stored value is not of the type that it should be."""


def to_plain(value: Any) -> Any:  # noqa: PLR0911  (a kind of value a line)
    """Turn dataclasses, enums, tuples, mappings with text keys, and arrays into what JSON holds."""
    if value is None or isinstance(value, bool | int | float | str):
        return value.value if isinstance(value, Enum) else value
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: to_plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Enum):
        return to_plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | frozenset | set):
        return [to_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
        return {"dtype": str(value.dtype), "shape": list(value.shape), "base64": data}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be stored")


def from_plain(kind: Any, plain: Any) -> Any:  # noqa: PLR0911  (a kind of value a line)
    """Make a value of a type of what `to_plain` gave; raises PlainError where it does not fit."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if plain is None and type(None) in arguments:
            return None
        (only,) = (argument for argument in arguments if argument is not type(None))
        return from_plain(only, plain)
    if origin is Literal:
        return _require(plain in arguments, plain, kind) and plain
    if origin is np.ndarray or kind is np.ndarray:
        return _array(plain)
    if origin is tuple:
        return _tuple(arguments, plain)
    if origin is list:
        _require(isinstance(plain, list), plain, kind)
        return [from_plain(arguments[0], item) for item in plain]
    if origin is not None and issubclass(origin, Mapping):
        _require(isinstance(plain, dict), plain, kind)
        return {from_plain(arguments[0], key): from_plain(arguments[1], item) for key, item in plain.items()}
    if is_dataclass(kind):
        return _dataclass(kind, plain)
    return _scalar(kind, plain)


def _scalar(kind: Any, plain: Any) -> Any:
    if kind is Any:
        return plain
    if isinstance(kind, type) and issubclass(kind, Enum):
        try:
            return kind(plain)
        except ValueError:
            raise PlainError(f"{plain!r} is no {kind.__name__}") from None
    if kind is float:
        _require(isinstance(plain, int | float) and not isinstance(plain, bool), plain, kind)
        return float(plain)
    if kind in (int, str, bool):
        _require(type(plain) is kind, plain, kind)
        return plain
    raise PlainError(f"values of {kind} are not stored")


def _tuple(arguments: tuple[Any, ...], plain: Any) -> tuple[Any, ...]:
    _require(isinstance(plain, list), plain, tuple)
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        return tuple(from_plain(arguments[0], item) for item in plain)
    _require(len(arguments) == len(plain), plain, arguments)
    return tuple(from_plain(kind, item) for kind, item in zip(arguments, plain, strict=True))


def _dataclass(kind: Any, plain: Any) -> Any:
    _require(isinstance(plain, dict), plain, kind)
    hints = _hints(kind)
    _require(plain.keys() == hints.keys(), plain, kind)
    return kind(**{name: from_plain(hint, plain[name]) for name, hint in hints.items()})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {one.name: hints[one.name] for one in fields(kind)}


def _array(plain: Any) -> Any:
    try:
        dtype, shape = plain["dtype"], tuple(plain["shape"])
        _require(dtype in ARRAY_TYPES, plain, np.ndarray)
        return np.frombuffer(base64.b64decode(plain["base64"], validate=True), dtype).reshape(shape).copy()
    except (TypeError, KeyError, ValueError) as problem:
        raise PlainError(f"no array: {problem}") from None


def _require(holds: bool, plain: Any, kind: Any) -> bool:
    if not holds:
        raise PlainError(f"{str(plain)[:80]} is no {getattr(kind, '__name__', kind)}")
    return True
