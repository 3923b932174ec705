"""Fixtures of the recording tests."""

from pathlib import Path

import pytest

from svmdist.profile import Profile, load_profile

from .builders import Entry, scene, write_scene


@pytest.fixture(scope="session")
def profile() -> Profile:
    """The profile whose topics the scene uses."""
    return load_profile("psm13")


@pytest.fixture(scope="session")
def entries() -> list[Entry]:
    """What the native recording holds."""
    return scene()


@pytest.fixture(scope="session")
def native(tmp_path_factory: pytest.TempPathFactory, entries: list[Entry]) -> Path:
    """A recording as `svmdist record` writes it."""
    return write_scene(tmp_path_factory.mktemp("native") / "scene.mcap", entries)
