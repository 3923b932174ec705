"""What a result depends on, as one number: the log's content, the request with everything it names, and the code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from svmdist.errors import SvmdistError
from svmdist.input_file import LogPath, content_sha256
from svmdist.remote_file import RemoteFile

PACKAGES = ("numpy", "opencv-python-headless", "simplejpeg", "av", "onnxruntime")
"""Other packages whose version can change a number."""


def fingerprint(value: object) -> str:
    """Hash a request: the same for equal ones, whatever process makes it."""
    digest = hashlib.sha256()
    digest.update(json.dumps(_described(value), sort_keys=True, ensure_ascii=True).encode())
    return digest.hexdigest()


@cache
def code_version() -> str:
    """svmdist's version and a hash of its code, and the versions of the packages that compute."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    packages = " ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return f"svmdist {_version('svmdist')} {digest.hexdigest()[:16]} {packages}"


def log_identity(path: LogPath) -> str:
    """The hash of a log's content; of one behind a URL what its store says of it, where it says something."""
    if isinstance(path, RemoteFile):
        try:
            stated = path.version()
        except OSError as problem:
            raise SvmdistError(f"{path}: cannot read: {problem.strerror or problem}") from None
        if stated is not None:
            return f"{path.url} {stated}"
    return content_sha256(path)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _described(value: object) -> Any:  # noqa: PLR0911, PLR0912  (a kind of value a line)
    """A value as plain data; files that it names count by their content."""
    if value is None or isinstance(value, bool | int | str):
        return value.value if isinstance(value, Enum) else value
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, Enum):
        return _described(value.value)
    if isinstance(value, BaseModel):
        return [type(value).__name__, {name: _described(item) for name, item in value}]
    if isinstance(value, Path):
        return content_sha256(value) if value.is_file() else str(value)
    if isinstance(value, np.ndarray):
        return [str(value.dtype), list(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    if isinstance(value, Mapping):
        return [[_described(key), _described(item)] for key, item in value.items()]
    if isinstance(value, list | tuple):
        return [_described(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted(json.dumps(_described(item), sort_keys=True) for item in value)
    if isinstance(value, bytes):
        return hashlib.sha256(value).hexdigest()
    if is_dataclass(value) and not isinstance(value, type):
        return [
            type(value).__name__,
            {one.name: _described(getattr(value, one.name)) for one in fields(value)},
        ]
    if isinstance(value, np.generic):
        return _described(value.item())
    if isinstance(value, partial):
        return [_described(value.func), _described(value.args), _described(value.keywords)]
    name = getattr(value, "__qualname__", None)
    if name is not None:
        return f"{getattr(value, '__module__', '')}.{name}"
    raise TypeError(f"{type(value).__name__} cannot be described")
