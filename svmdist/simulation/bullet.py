"""The door to PyBullet: loading it with a clear error where it is missing, and quiet worlds.

PyBullet's C code prints to the process's standard output; data goes there, so its chatter must not.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from svmdist.errors import SimulationError
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

WHEELS_UP_TO = (3, 11)
"""The last CPython that PyBullet publishes wheels for, as the extra `sim` in pyproject.toml has it."""


@contextmanager
def quiet(descriptor: int = 1) -> Iterator[None]:
    """Discard what C code writes to a file descriptor."""
    sys.stdout.flush()
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


def require_pybullet() -> None:
    """Raise SimulationError where PyBullet is not installed, without loading it."""
    if importlib.util.find_spec("pybullet") is None:
        load_pybullet()


def load_pybullet() -> Any:
    """Import PyBullet, or raise SimulationError that says why it is missing and what to do."""
    try:
        with quiet(1), quiet(2):  # the banner with the build time goes to standard error
            return importlib.import_module("pybullet")
    except ImportError as problem:
        advice = how_to_install(sys.version_info[:2], sys.platform, platform.machine())
        raise SimulationError(f"recording needs PyBullet: {advice} ({problem})") from None


def how_to_install(version: tuple[int, int], system: str, machine: str) -> str:
    """How to get PyBullet, which the extra `sim` installs only where there are wheels of it."""
    if version == WHEELS_UP_TO and system == "linux" and machine == "x86_64":
        return "run pip install 'svmdist[sim]', or in a clone uv run --extra sim svmdist"
    last, here = (".".join(map(str, numbers)) for numbers in (WHEELS_UP_TO, version))
    return (
        f"it has wheels for Linux x86_64 and CPython up to {last} only, so that svmdist[sim] installs nothing here"
        f" (CPython {here}, {system} {machine}): use Python {last} there and run pip install 'svmdist[sim]'"
    )


class BulletWorld(ExitStack):
    """One physics world of PyBullet without a window; a context manager that disconnects at its end."""

    def __init__(self) -> None:
        super().__init__()
        self.pb = load_pybullet()
        with quiet():
            self._id = int(self.pb.connect(self.pb.DIRECT))
        if self._id < 0:
            raise SimulationError("PyBullet has no free physics world: too many simulations run at once")
        self.callback(self.pb.disconnect, physicsClientId=self._id)

    def call(self, function: str, *args: Any, **kwargs: Any) -> Any:
        """Call a function of PyBullet in this world; its own error becomes a SimulationError."""
        try:
            return getattr(self.pb, function)(*args, physicsClientId=self._id, **kwargs)
        except self.pb.error as problem:
            raise SimulationError(f"PyBullet could not {function}: {problem}") from None

    def place(self, body: int, T_world_body: Array, scale: float = 1.0) -> None:
        """Put a body at a pose, shape (4, 4), whose translation is scaled."""
        quaternion = quaternion_xyzw_from_rotation(T_world_body[:3, :3]).tolist()
        self.call("resetBasePositionAndOrientation", body, (T_world_body[:3, 3] * scale).tolist(), quaternion)
