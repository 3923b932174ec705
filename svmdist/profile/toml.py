"""Files in TOML as frozen models: what is wrong with one becomes a line that names the file and the key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from svmdist.errors import SvmdistError, did_you_mean
from svmdist.input_file import read_regular, why

MAX_DEPTH = 50
MAX_DIGITS = 1000
"""Python itself refuses to read more than 4,300; a number of 64 bits has 20."""
TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*|\d[\d_]*|[][{}\n]',
    re.DOTALL,
)
KEY = re.compile(r"[^=\n]*")
HEADER = re.compile(r"[ \t]*\[+([^]\n]*)\]+")


def find_excess(text: str) -> str | None:
    """Say in a few words where a document asks for too much: its line and key; None where it does not.

    Strings and comments are passed over. What is no TOML at all is left to the parser.
    """
    depth, line, statement, table = 0, 1, 0, ""
    position = 0
    while position < len(text):
        header = HEADER.match(text, position) if depth == 0 and position == statement else None
        if header is not None:
            table, position = header[1].strip(), header.end()
            continue
        found = TOKEN.search(text, position)
        if found is None:
            break
        token, position = found[0], found.end()
        line += token.count("\n")
        excess = None
        if token == "\n":
            if depth == 0:
                statement = position
        elif token in "[{":
            depth += 1
            excess = f"nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else None
        elif token in "]}":
            depth = max(depth - 1, 0)
        elif token[0].isdigit() and len(token) > MAX_DIGITS:
            excess = f"a number of more than {MAX_DIGITS} digits"
        if excess is not None:
            key = KEY.match(text, statement)
            return f"line {line}, key {_name(table, key[0] if key else '')}: {excess}"
    return None


def _name(table: str, key: str) -> str:
    name = ".".join(part for part in (table, key.strip()) if part)
    return name if len(name) <= 80 else f"{name[:77]}..."


Model = TypeVar("Model", bound="StrictModel")


class StrictModel(BaseModel):
    """Base of everything read from TOML: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="after")
    @classmethod
    def _bounded(cls, value: Any) -> Any:
        """Numbers that overflow when they are squared, or vanish, are a slip of the pen."""
        _require_bounded(value)
        return value


def _require_bounded(value: Any) -> None:
    if isinstance(value, float):
        if value and not MIN_NUMBER <= abs(value) <= MAX_NUMBER:
            raise ValueError(f"a number is 0, or from {MIN_NUMBER:g} to {MAX_NUMBER:g} in size")
    elif isinstance(value, tuple | list):
        for item in value:
            _require_bounded(item)
    elif isinstance(value, dict):
        for item in value.values():
            _require_bounded(item)


def _parse_angle(value: Any) -> Any:
    """Accept a number in rad, or a multiple of pi such as `pi`, `-pi/2`, `2*pi/3`, which has no last digit."""
    if not isinstance(value, str):
        return value
    text = value.replace(" ", "")
    sign, text = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    factor, times, rest = text.rpartition("*")
    symbol, over, divisor = rest.partition("/")
    try:
        if symbol != "pi":
            raise ValueError
        return sign * (float(factor) if times else 1.0) * np.pi / (float(divisor) if over else 1.0)
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f"expected rad as a number or a multiple of pi such as 'pi/2', found {value!r}"
        ) from None


def _parse_size(value: Any) -> Any:
    """Accept a number of bytes, or text such as `512 MiB`."""
    if not isinstance(value, str):
        return value
    number, _, unit = value.partition(" ")
    if not number.isdecimal() or unit not in SIZE_UNITS:
        raise ValueError(f"expected bytes as a number, or as '512 MiB', found {value!r}")
    return int(number) * SIZE_UNITS[unit]


def _beside_the_file(path: Path, info: ValidationInfo) -> Path:
    """A relative path starts from the folder of the file that names it, wherever the program was started."""
    if "\0" in str(path):
        raise ValueError("a path cannot have the character NUL")
    return Path(info.context["folder"]) / path if info.context else path


MAX_FAULTS = 5
"""More faults of a file than these are counted, not told."""
FEW_KEYS = 3
"""A file with more keys, most of which are unknown, is taken for one of another kind."""
MAX_FILE_BYTES = 4 << 20
"""A profile has a few kilobytes."""
MAX_NUMBER, MIN_NUMBER = 1e9, 1e-30
"""Squares of such numbers, and what is divided by them, are numbers still; nothing real is beyond."""
SIZE_UNITS = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
MIB = SIZE_UNITS["MiB"]
Angle = Annotated[float, BeforeValidator(_parse_angle)]
Size = Annotated[int, BeforeValidator(_parse_size), Field(ge=1 << 10, le=1 << 40)]
Length = Annotated[float, Field(gt=1e-6, lt=10.0)]
"""A micrometre is less than anything here is measured to."""
SmallLength = Annotated[float, Field(gt=1e-6, lt=0.1)]
"""Of a part that a hand holds: 0.1 m and more is a number of millimetres that was meant."""
NeighbourFile = Annotated[Path, AfterValidator(_beside_the_file)]
Byte = Annotated[int, Field(ge=0, le=255)]
Hue = Annotated[int, Field(ge=0, le=179)]


def parse_toml(path: Path, model: type[Model], error: type[SvmdistError]) -> Model:
    """Read a TOML file into a model; every problem becomes one line that names the file and the key."""
    try:
        text = read_regular(path, MAX_FILE_BYTES).decode("utf-8")
        excess = find_excess(text)
        if excess is not None:
            raise error(f"{path}: {excess}")
        data = tomllib.loads(text)
    except OSError as problem:
        raise error(f"{path}: cannot read: {why(problem)}") from None
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not a TOML file: byte {problem.start} is not UTF-8") from None
    except (ValueError, RecursionError) as problem:  # TOMLDecodeError is a ValueError
        raise error(f"{path}: not a TOML file: {problem}") from None
    try:
        return model.model_validate(data, context={"folder": path.parent})
    except ValidationError as problem:
        known = {field.alias or name: field.is_required() for name, field in model.model_fields.items()}
        if len(data) >= FEW_KEYS and 2 * sum(key in known for key in data) < len(data):
            needed = ", ".join([key for key, is_required in known.items() if is_required] or known)
            found = ", ".join(_short(key) for key in data)
            kind = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", model.__name__).lower().removesuffix("-file")
            raise error(f"{path}: not a {kind} file: expected the keys {needed}; found {found}") from None
        faults = list(_describe(problem, model))
        if len(faults) > MAX_FAULTS:
            faults[MAX_FAULTS:] = [f"and {len(faults) - MAX_FAULTS} more"]
        raise error(f"{path}: {'; '.join(faults)}") from None


def _describe(problem: ValidationError, model: type[BaseModel]) -> Iterator[str]:
    for item in problem.errors(include_url=False):
        location = item["loc"]
        key, _ = _resolve(model, location)
        if item["type"] == "extra_forbidden":
            _, siblings = _resolve(model, location[:-1])
            fields = siblings.model_fields if siblings else {}
            choices = [field.alias or name for name, field in fields.items()]
            yield f"unknown key {key}: {did_you_mean(str(location[-1]), choices)}"
        elif item["type"] == "missing":
            yield f"missing key {key}"
        else:
            message = item["msg"].removeprefix("Value error, ")
            # A rule about a table as a whole says itself what it found; the table would only be in the way.
            found = "" if isinstance(item["input"], dict) else f" (found {_short(item['input'])})"
            yield f"{key}: {message}{found}" if key else message


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _resolve(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[str, type[BaseModel] | None]:
    """The key that a location inside a document is written as, and the model class that it is checked by.

    Pydantic puts the tag of the union's member that it tried into a location; no such key stands in the file.
    """
    annotation: Any = model
    key: list[str] = []
    for part in location:
        tagged = _tagged(annotation)
        if part in tagged:
            annotation = tagged[part]
            continue
        key.append(str(part))
        if isinstance(part, int):
            continue
        found = next(_models_in(annotation), None)
        annotation = found.model_fields[part].annotation if found and part in found.model_fields else None
    return ".".join(key), next(_models_in(annotation), None)


def _tagged(annotation: Any) -> dict[int | str, Any]:
    """The members of a union by their tags."""
    return {
        mark.tag: member
        for member in getattr(annotation, "__args__", ())
        for mark in getattr(member, "__metadata__", ())
        if isinstance(mark, Tag)
    }


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from _models_in(argument)
