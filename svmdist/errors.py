"""The errors that svmdist raises on purpose, a class for each thing a caller can do about it: messages of one line."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

UNSAFE = {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}  # control, format, surrogates, private, line breaks
USER = re.compile(r"(?<=[A-Za-z0-9]{2}:/)/*(?:[^/?#\s]*@(?=[^/?#\s])|[^/?#@:\s]*:(?!\d+(?:/|$))\S*@)")
"""User and password of a URL, with the slashes before them; a key of S3 may have slashes, and no port has a path."""
QUERY = re.compile(r"([A-Za-z0-9]{2}:/[^\s?#]*)([?#]\S*)")
"""A URL up to its query, and the query."""


def concealed(text: str) -> str:
    """Text whose URLs are without user, password and query, which may be secrets.

    >>> concealed("s3://KEY:SECRET@bucket/a.mcap: no such file")
    's3://bucket/a.mcap: no such file'
    """
    return QUERY.sub(r"\1", USER.sub(lambda user: "/" * user[0].count("/", 0, 1), text))


class SvmdistError(Exception):
    """Base of all errors that svmdist raises on purpose; its text is one line, without the secrets of URLs."""

    def __init__(self, *texts: str) -> None:
        super().__init__(*map(concealed, texts))


class Terminated(KeyboardInterrupt):
    """The process was asked to end by a signal other than an interrupt; `signal_number` says which."""

    def __init__(self, signal_number: int) -> None:
        super().__init__()
        self.signal_number = signal_number


class UsageError(SvmdistError):
    """The request itself is wrong: an option's value, a combination, a file that may not be replaced."""


class ProfileError(SvmdistError):
    """A profile file cannot be used: missing, not TOML, an unknown key, a bad value."""


class CalibrationError(SvmdistError):
    """A calibration file cannot be used, or does not fit the recording's camera or the method."""


class RecordingError(SvmdistError):
    """A recording cannot be used at all: missing, empty, of another format, without a needed topic."""


class SourceError(SvmdistError):
    """Files cannot be imported: missing, of another form, or images, calibration and tables that do not match."""


class OutputError(SvmdistError):
    """A result cannot be written: no such folder, no permission, no space left."""


class SimulationError(SvmdistError):
    """The simulation cannot run: PyBullet is missing, a pose is out of reach."""


class KinematicsError(SvmdistError):
    """Joint values or a chain do not fit together: a missing joint, a wrong shape."""


@contextmanager
def restated(
    kind: type[Exception] | tuple[type[Exception], ...], error: Callable[[str], Exception], before: str = ""
) -> Iterator[None]:
    """Turn exceptions of some kinds into `error` of the same text in one line, behind some words."""
    try:
        yield
    except kind as problem:
        raise error(f"{before}{' '.join(str(problem).split())}") from None


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """Name the choices for a wrong name, the nearest one first.

    >>> did_you_mean("sweeep", ["approach", "sweep"])
    'did you mean sweep? The choices are: approach, sweep'
    """
    from difflib import get_close_matches  # here: whatever starts loads this module, and few of them need it

    known = sorted(choices)
    if not known:
        return "there are none to choose from"
    listed = f"he choices are: {', '.join(known)}"
    folded = {choice.casefold(): choice for choice in known}
    nearest = get_close_matches(name.casefold(), folded, n=1, cutoff=0.5)
    return f"did you mean {folded[nearest[0]]}? T{listed}" if nearest else f"t{listed}"


def optional_package(name: str, extra: str, what: str, error: type[SvmdistError] = SvmdistError) -> Any:
    """Import an optional package; raise `error`, which says that `what` needs it, where it is not installed."""
    from importlib import import_module

    try:
        package = import_module(name)
    except ImportError:
        missing = f"the package {name}, which is not installed"
        raise error(f"{what} needs {missing}: pip install 'svmdist[{extra}]'") from None
    if name == "av":
        package.logging.set_level(None)  # else a decoding thread that logs and its end wait for each other
    return package


def printable(text: str) -> str:
    """Text with U+FFFD for control, format and surrogate characters, which could drive a terminal."""
    return "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in UNSAFE else c for c in text)
