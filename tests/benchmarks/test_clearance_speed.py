"""The clearance of one frame, beside every capsule against every triangle, and the simulation's true clearance.

Run with `uv run pytest tests/benchmarks/test_clearance_speed.py --benchmark-enable --benchmark-group-by=group`.
"""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.estimation.dome import DomeModel
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.tissue import tissue_frame
from svmdist.geometry.distance import capsule_separation, segment_to_triangle, separation
from svmdist.geometry.surfaces import Capsules, Cloud, Plane
from svmdist.kinematics.dh import chain_of
from svmdist.profile import Dome, load_profile
from svmdist.results import ToolPose
from svmdist.samples import JointSample
from svmdist.transforms import make_transform, rotation_x, transform_points
from tests.rotations import rotation_y

PROFILE = load_profile()
RULE = Dome(height_m=0.008, gauge_exponent=2.3, height_exponent=0.62, height_std_m=1.5e-4, apex_std_m=2e-3)
NORMAL = np.array([0.1, -0.3, -0.95]) / np.linalg.norm([0.1, -0.3, -0.95])
T_CAMERA_TISSUE = tissue_frame(np.array([0.004, -0.003, 0.11]), NORMAL)
ANGLE = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
OUTLINE_M = transform_points(
    T_CAMERA_TISSUE, np.stack([0.028 * np.cos(ANGLE), 0.022 * np.sin(ANGLE), 0.0 * ANGLE], -1)
)


MODEL = InstrumentModel.of(PROFILE)
assert MODEL is not None
assert PROFILE.robot is not None
NAMES = chain_of(PROFILE.robot).joint_names
JOINTS = JointSample(0, NAMES, np.linspace(0.1, 0.4, len(NAMES)))


def body(gap_m: float, x_m: float = 0.003) -> Capsules:
    """The instrument before the camera, its tip about that far over the dome, with its wrist bent."""
    assert MODEL is not None
    at = transform_points(T_CAMERA_TISSUE, np.array([[x_m, 0.002, 0.016 + gap_m]]))[0]
    T = make_transform(rotation_y(-0.9) @ rotation_x(0.4), at)
    return MODEL.posed(ToolPose(T, np.zeros((6, 6)), T[:3, 0]), JOINTS)


@pytest.mark.benchmark(group="clearance to a new dome")
@pytest.mark.parametrize("gap_m", [0.001, 0.02])
def test_dome_of_a_frame(benchmark: BenchmarkFixture, gap_m: float) -> None:
    """A new outline's dome, its mesh, the capsules, the separation and the dome's variance there."""

    def frame() -> float:
        dome = DomeModel.over(OUTLINE_M, T_CAMERA_TISSUE, RULE)
        gap = separation(body(gap_m), dome.mesh())
        return dome.variance_m2(gap.on_tissue_m, gap.direction)

    assert benchmark(frame) > 0.0


@pytest.mark.benchmark(group="clearance to a new dome")
def test_every_triangle_in_turn(benchmark: BenchmarkFixture) -> None:
    """What pruning spares: all capsules against all triangles, without inside and outside."""
    capsules, mesh = body(0.02), DomeModel.over(OUTLINE_M, T_CAMERA_TISSUE, RULE).mesh()
    expected = separation(capsules, mesh).distance_m

    def every() -> float:
        found = segment_to_triangle(
            capsules.start_m[:, None], capsules.end_m[:, None], mesh.triangles_m[None]
        )
        return float((found.distance - capsules.radius_m[:, None]).min())

    assert benchmark(every) == pytest.approx(expected, abs=1e-12)


@pytest.mark.benchmark(group="clearance to other surfaces")
@pytest.mark.parametrize("kind", ["plane", "cloud", "instrument"])
def test_other_surfaces(benchmark: BenchmarkFixture, kind: str) -> None:
    capsules = body(0.005)
    mesh = DomeModel.over(OUTLINE_M, T_CAMERA_TISSUE, RULE).mesh()
    if kind == "instrument":
        other = body(0.005, -0.01)
        benchmark(lambda: capsule_separation(capsules, other))
        return
    points = np.concatenate([mesh.vertices_m, mesh.triangles_m.mean(1)])[:2000]
    surface = Plane(NORMAL, float(NORMAL @ T_CAMERA_TISSUE[:3, 3])) if kind == "plane" else Cloud(points)
    benchmark(lambda: separation(capsules, surface))
