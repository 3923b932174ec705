from __future__ import annotations

import pytest

from svmdist.profile import Profile, load_profile
from svmdist.simulation.scene import Scene, make_scene


@pytest.fixture(scope="session")
def profile() -> Profile:
    return load_profile()


@pytest.fixture(scope="session")
def scene(profile: Profile) -> Scene:
    return make_scene(profile, 1)
