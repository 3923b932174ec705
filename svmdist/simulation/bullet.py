"""The door to PyBullet: loading it with a clear error where it is missing, and quiet connections.

PyBullet's C code prints to the process's standard output; data goes there, so its chatter must not.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from svmdist.errors import SimulationError


@contextmanager
def quiet_stdout() -> Iterator[None]:
    """Send what C code writes to file descriptor 1 to nowhere for the time of the block."""
    sys.stdout.flush()
    with _quiet(1):
        yield


@contextmanager
def _quiet(descriptor: int) -> Iterator[None]:
    try:
        saved = os.dup(descriptor)
    except OSError:  # it is closed: there is nothing to keep clean
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), descriptor)
        yield
    finally:
        # C keeps its own buffer: without this it would be written after all, when the process ends.
        ctypes.CDLL(None).fflush(None)
        os.dup2(saved, descriptor)
        os.close(saved)


def load_pybullet() -> Any:
    """Import PyBullet, or raise SimulationError that says why it is missing and what to do."""
    try:
        # The banner with the build time goes to standard error.
        with quiet_stdout(), _quiet(2):
            return importlib.import_module("pybullet")
    except ImportError as problem:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise SimulationError(
            "recording needs PyBullet, which has wheels for Linux x86_64 and CPython up to 3.11 only "
            f"(this is CPython {version} on {sys.platform}): use Python 3.11 there and run "
            f"pip install 'svmdist[sim]' ({problem})"
        ) from None


class BulletClient:
    """One physics world of PyBullet without a window; a context manager that disconnects at its end."""

    def __init__(self) -> None:
        self.pb = load_pybullet()
        with quiet_stdout():
            self.id: int = self.pb.connect(self.pb.DIRECT)
        if self.id < 0:
            raise SimulationError("PyBullet has no free physics world: too many simulations run at once")

    def call(self, function: str, *args: Any, **kwargs: Any) -> Any:
        """Call a function of PyBullet in this world; its own error becomes a SimulationError."""
        try:
            return getattr(self.pb, function)(*args, physicsClientId=self.id, **kwargs)
        except self.pb.error as problem:
            raise SimulationError(f"PyBullet could not {function}: {problem}") from None

    def close(self) -> None:
        """Disconnect; a second call does nothing."""
        if self.id >= 0:
            self.pb.disconnect(physicsClientId=self.id)
            self.id = -1

    def __enter__(self) -> BulletClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
