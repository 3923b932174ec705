"""The URDF made from the DH table moves as the table says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.kinematics.dh import DHChain, DHRow, frame_transforms
from svmdist.simulation.scene import Scene
from svmdist.simulation.urdf import urdf_of
from svmdist.transforms import rotation_angle, rotation_from_quaternion_xyzw

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.bullet import BulletClient


def largest_errors(chain: DHChain, folder: Path, count: int) -> tuple[float, float]:
    """Largest difference of any DH frame from PyBullet's link, in m and rad, over random joints.

    The link's frame of mass is read: it is the link's frame here, and the other one that PyBullet returns
    passes through single precision.
    """
    file = folder / "robot.urdf"
    file.write_text(urdf_of(chain, "robot"), "utf-8")
    rng = np.random.default_rng(0)
    error_m = error_rad = 0.0
    with BulletClient() as client:
        body = client.call("loadURDF", str(file), useFixedBase=True)
        infos = [client.call("getJointInfo", body, i) for i in range(client.call("getNumJoints", body))]
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        for _ in range(count):
            q = rng.uniform(chain.lower, chain.upper)
            for name, value in zip(chain.joint_names, q, strict=True):
                client.call("resetJointState", body, joints[name], value)
            frames = frame_transforms(chain, q)
            named = [(row.name, T) for row, T in zip(chain.rows, frames, strict=True)]
            for name, T in [*named, ("tool", frames[-1] @ chain.T_last_tool)]:
                state = client.call("getLinkState", body, links[name], computeForwardKinematics=True)
                error_m = max(error_m, float(np.abs(np.array(state[0]) - T[:3, 3]).max()))
                R = rotation_from_quaternion_xyzw(state[1])
                error_rad = max(error_rad, float(rotation_angle(R, T[:3, :3])))
    return error_m, error_rad


def test_dh_kinematics_equals_pybullets(scene: Scene, tmp_path: Path) -> None:
    """All 13 frames and the tool, over 1,000 joint vectors inside the limits: 1e-9 m, 1e-9 rad."""
    error_m, error_rad = largest_errors(scene.chain, tmp_path, 1000)
    assert error_m < 1e-9
    assert error_rad < 1e-9


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_any_chain_becomes_a_urdf(convention: str, tmp_path: Path) -> None:
    """Random rows of both conventions, gimbal lock and a fixed row among them."""
    rng = np.random.default_rng(5)
    rows = (
        DHRow("a", "revolute", *rng.uniform(-1, 1, 4)),
        DHRow("b", "fixed", 0.1, np.pi / 2, 0.2, np.pi / 2),
        DHRow("c", "prismatic", *rng.uniform(-1, 1, 4)),
        DHRow("d", "revolute", 0.1, np.pi / 2, 0.2, np.pi / 2),
    )
    error_m, error_rad = largest_errors(DHChain(rows, convention), tmp_path, 50)
    assert error_m < 1e-9
    assert error_rad < 1e-9
