"""What is said where PyBullet is missing follows the extra's own marker."""

from __future__ import annotations

import itertools
import tomllib

from packaging.requirements import Requirement

from svmdist.simulation.bullet import how_to_install
from tests.conftest import REPOSITORY


def test_where_the_extra_installs_nothing_it_is_said() -> None:
    extras = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    (requirement,) = map(Requirement, extras["sim"])
    assert requirement.marker is not None
    places = itertools.product(
        [(3, 11), (3, 12), (3, 13)], ["linux", "darwin", "win32"], ["x86_64", "aarch64"]
    )
    installed = 0
    for version, system, machine in places:
        python = ".".join(map(str, version))
        environment = {"python_version": python, "sys_platform": system, "platform_machine": machine}
        said = how_to_install(version, system, machine)
        assert "pip install 'svmdist[sim]'" in said
        if requirement.marker.evaluate(environment):
            installed += 1
            assert "nothing" not in said
        else:
            assert "svmdist[sim] installs nothing here" in said
            assert f"CPython {python}, {system} {machine}" in said
    assert installed == 1
