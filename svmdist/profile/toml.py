"""Files in TOML as frozen models: what is wrong with one becomes one line that names the file and the key."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import pydantic
from pydantic import Field
from pydantic_core import PydanticCustomError

from svmdist.errors import SvmdistError, did_you_mean
from svmdist.files import read_regular, reading

MAX_FAULTS = 5  # of a file that are listed; the others are counted
FEW_KEYS = 3  # a file with more, most of which are unknown, is of another kind
MAX_FILE_BYTES = 4 << 20  # a profile has a few kilobytes
MAX_NUMBER, MIN_NUMBER = 1e9, 1e-30
"""Nothing real is beyond, and squares and quotients of such numbers neither overflow nor vanish."""
UNKNOWN = "unknown_key"
SIZE_UNITS = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}


class StrictModel(pydantic.BaseModel):
    """Base of what is read from TOML: frozen, and an unknown key or an absurd number is an error."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _no_unknown_keys(cls, data: Any) -> Any:
        keys = [field.alias or name for name, field in cls.model_fields.items()]
        unknown = [str(key) for key in data if key not in keys] if isinstance(data, dict) else []
        if hints := {key: did_you_mean(key, keys) for key in unknown}:
            raise PydanticCustomError(UNKNOWN, "unknown key: {hints}", {"hints": hints})
        return data

    @pydantic.field_validator("*", mode="after")
    @classmethod
    def _bounded(cls, value: Any) -> Any:
        for part in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
            cls._bounded(part)
        if isinstance(value, float) and value and not MIN_NUMBER <= abs(value) <= MAX_NUMBER:
            raise ValueError(f"a number is 0, or from {MIN_NUMBER:g} to {MAX_NUMBER:g} in size")
        return value

    @pydantic.model_validator(mode="after")
    def _sound(self) -> Self:
        self._require_sound()
        return self

    def _require_sound(self) -> None:
        """Raise ValueError where values do not go together; each model has its own rules."""


Model = TypeVar("Model", bound=StrictModel)


def _parse_angle(value: Any) -> Any:
    """Accept a number in rad, or a multiple of pi such as `pi`, `-pi/2`, `2*pi/3`, which has no last digit."""
    if not isinstance(value, str):
        return value
    found = re.fullmatch(r"(-?)(?:(.+)\*)?pi(?:/(.+))?", value.replace(" ", ""))
    try:
        sign, factor, divisor = found.groups("1") if found else ("", "", "")
        return float(f"{sign}1") * float(factor) * math.pi / float(divisor)
    except (ValueError, ZeroDivisionError):
        raise ValueError(f"expected rad as a number or a multiple of pi such as 'pi/2', found {value!r}") from None


def _parse_size(value: Any) -> Any:
    """Accept a number of bytes, or text such as `512 MiB`."""
    if not isinstance(value, str):
        return value
    number, _, unit = value.partition(" ")
    if not number.isdecimal() or unit not in SIZE_UNITS:
        raise ValueError(f"expected bytes as a number, or as '512 MiB', found {value!r}")
    return int(number) * SIZE_UNITS[unit]


def _beside_the_file(path: Path, info: pydantic.ValidationInfo) -> Path:
    """A relative path starts from the folder of the file that names it."""
    if "\0" in str(path):
        raise ValueError("a path cannot have the character NUL")
    return Path(info.context["folder"]) / path if info.context else path


Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Level = Annotated[float, Field(ge=0.0, le=255.0)]
Count = Annotated[int, Field(ge=1)]
Angle = Annotated[float, pydantic.BeforeValidator(_parse_angle)]
Size = Annotated[int, pydantic.BeforeValidator(_parse_size), Field(ge=1 << 10, le=1 << 40)]
Length = Annotated[float, Field(gt=1e-6, lt=10.0)]
SmallLength = Annotated[float, Field(gt=1e-6, lt=0.1)]
"""Of a part that a hand holds: 0.1 m and more is a number of millimetres that was meant."""
NeighbourFile = Annotated[Path, pydantic.AfterValidator(_beside_the_file)]
Byte = Annotated[int, Field(ge=0, le=255)]
Hue = Annotated[int, Field(ge=0, le=179)]


def parse_toml(path: Path, model: type[Model], error: type[SvmdistError]) -> Model:
    """Read a TOML file into a model; every problem becomes one line that names the file and the key."""
    try:
        with reading(path, error):
            data = tomllib.loads(read_regular(path, MAX_FILE_BYTES).decode("utf-8-sig"))
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not a TOML file: byte {problem.start} is not UTF-8") from None
    except RecursionError:
        raise error(f"{path}: not a TOML file: nested too deeply") from None
    except ValueError as problem:  # TOMLDecodeError among them
        raise error(f"{path}: not a TOML file: {problem}") from None
    try:
        return model.model_validate(data, context={"folder": path.parent})
    except pydantic.ValidationError as problem:
        needed = {field.alias or name: field.is_required() for name, field in model.model_fields.items()}
        if len(data) >= FEW_KEYS and 2 * len(needed.keys() & data.keys()) < len(data):
            kind = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", model.__name__).lower().removesuffix("-file")
            keys = ", ".join([key for key in needed if needed[key]] or needed)
            found = ", ".join(_short(key) for key in data)
            raise error(f"{path}: not a {kind} file: expected the keys {keys}; found {found}") from None
        raise error(f"{path}: {in_words(problem)}") from None


def in_words(problem: pydantic.ValidationError) -> str:
    """What is wrong with the first keys, and with how many more."""
    faults: list[str] = []
    for item in problem.errors(include_url=False):
        # A union's tag in parentheses is no key of the file.
        table = [str(part) for part in item["loc"] if not str(part).startswith("(")]
        key = ".".join(table)
        if item["type"] == UNKNOWN:
            hints = item["ctx"]["hints"].items()
            faults += [f"unknown key {'.'.join([*table, name])}: {hint}" for name, hint in hints]
        elif item["type"] == "missing":
            faults.append(f"missing key {key}")
        else:
            message = item["msg"].removeprefix("Value error, ")
            # A rule about a whole table says itself what it found.
            found = "" if isinstance(item["input"], dict) else f" (found {_short(item['input'])})"
            faults.append(f"{key}: {message}{found}" if key else message)
    if len(faults) > MAX_FAULTS:
        faults[MAX_FAULTS:] = [f"and {len(faults) - MAX_FAULTS} more"]
    return "; ".join(faults)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
