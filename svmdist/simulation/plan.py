"""The plan of a recording: all that is settled before the first image, and its division into blocks.

A plan holds no physics world and can be sent to another process. A block is one image with all samples up to the
next; each can be made by itself, so that the content does not depend on who makes it, or in which order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics import chain_of
from svmdist.perturbations.calibration import built_profile
from svmdist.profile import Profile
from svmdist.simulation.arm import Arm, draw_nominal_kinematics, reported_joints
from svmdist.simulation.motion import make_other_arms, make_trajectory
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import Array

START_NS = 1_700_000_000_000_000_000
"""The stamp of the first sample. No clock is read, so that a rerun gives the same log."""
CAMERA_INFO_PERIOD_NS = 1_000_000_000


@dataclass(frozen=True)
class Block:
    """The stamps from number `begin` to before `end`; the first of them is that of image number `frame`."""

    frame: int
    begin: int
    end: int


@dataclass(frozen=True)
class SceneState:
    """Joints of each arm, (n_joints,), the retractor's pose, (4, 4), and the tissue's offset from rest in m."""

    q: tuple[Array, ...]
    T_world_retractor: Array | None
    offset_m: float


@dataclass(frozen=True)
class Plan:
    """A recording before it is made; the first arm's scene is the world's.

    All arrays have one entry for each stamp: `stamps_ns` (n,), whether an image, joints or the cameras' calibration
    come with it (n,), the retractor's poses (n, 4, 4), or None where there is none, and the tissue's offset (n,).
    """

    profile: Profile
    scene: Scene
    arms: tuple[Arm, ...]
    topics: dict[str, str]
    noise: float
    options: Options
    stamps_ns: NDArray[np.int64]
    with_image: NDArray[np.bool_]
    with_joints: NDArray[np.bool_]
    with_camera_info: NDArray[np.bool_]
    T_world_retractor: Array | None
    tissue_offset_m: Array

    @property
    def blocks(self) -> list[Block]:
        """All blocks in the order of time; the first image has the first stamp."""
        begins = np.nonzero(self.with_image)[0].tolist()
        ends = [*begins[1:], len(self.stamps_ns)]
        return [Block(frame, *span) for frame, span in enumerate(zip(begins, ends, strict=True))]

    def state(self, index: int, after_ns: float = 0.0) -> SceneState:
        """The state at the stamp number `index`, or later: interpolated between stamps, still after the last one."""
        if not after_ns:
            return self._state(lambda values: values[index])
        since_ns = self.stamps_ns - self.stamps_ns[index]  # stamps are too large for a float
        above = int(np.clip(np.searchsorted(since_ns, after_ns), 1, len(since_ns) - 1))
        below = above - 1
        share = min((after_ns - since_ns[below]) / (since_ns[above] - since_ns[below]), 1.0)
        return self._state(lambda values: values[below] + share * (values[above] - values[below]))

    def _state(self, at: Callable[[Array], Array]) -> SceneState:
        return SceneState(
            tuple(at(arm.q) for arm in self.arms),
            # The retractor's blade slides, and never turns.
            None if self.T_world_retractor is None else at(self.T_world_retractor),
            float(at(self.tissue_offset_m)),
        )


def make_plan(
    scenario: Scenario, profile: Profile, *, noise: float = 0.0, options: Options | None = None
) -> Plan:
    """Plan a recording; `noise` is a standard deviation in 8-bit levels.

    Joints and poses come at the profile's joint rate, transforms and truth at every image's stamp. Raises
    SimulationError where PyBullet is missing and needed, or the profile cannot be simulated.
    """
    options = options or Options()
    built = built_profile(profile, options.perturbations, scenario.seed)
    scene = make_scene(built, scenario.seed, options)
    settings = built.simulation
    assert settings is not None  # make_scene has checked it
    images = _stamps(scenario.frame_count, scenario.rate_hz)
    # Joints up to the end of the recording, so that every image lies between two of them.
    joint_count = int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1
    joints = _stamps(joint_count, settings.joint_rate_hz)
    stamps = np.union1d(images, joints)
    with_joints = np.isin(stamps, joints)
    with_camera_info = np.zeros(len(stamps), np.bool_)
    with_camera_info[np.searchsorted(stamps, np.arange(START_NS, stamps[-1] + 1, CAMERA_INFO_PERIOD_NS))] = (
        True
    )
    progress = np.clip((stamps - START_NS) / (scenario.duration_s * 1e9), 0.0, 1.0)
    path_s = progress * scenario.duration_s
    path, T_world_retractor = make_trajectory(scene, scenario, settings.working_height_m, progress)

    def arm(number: int, view: Profile, its: Scene, q: Array, distance: str, prefix: str = "") -> Arm:
        """An arm that takes itself for the profile's."""
        assert view.robot is not None  # the scene has checked it
        nominal = draw_nominal_kinematics(
            chain_of(view.robot), its.T_camera_base, view, scenario.seed, options.kinematic_error, number
        )
        exact = q + nominal.joint_offsets
        exact[:, -1] -= its.jaw_opening_rad(path_s, number)
        reported = reported_joints(
            exact, stamps, with_joints, view, options.perturbations, scenario.seed, number
        )
        return Arm(view, its, complete_topics(view, distance), q, nominal, reported, prefix)

    arms = [arm(0, profile, scene, path, "/ground_truth/distance")]
    others = make_other_arms(built, scene, options, path, progress, scenario.duration_s)
    for number, (name, its, q) in enumerate(others, start=1):
        view, distance = profile.for_instrument(name), f"/ground_truth/{name}/distance"
        arms.append(arm(number, view, its, q, distance, prefix=f"{name}_"))
    return Plan(
        profile=profile,
        scene=scene,
        arms=tuple(arms),
        topics=complete_topics(profile),
        noise=noise,
        options=options,
        stamps_ns=stamps,
        with_image=np.isin(stamps, images),
        with_joints=with_joints,
        with_camera_info=with_camera_info,
        T_world_retractor=T_world_retractor,
        tissue_offset_m=scene.tissue_offset_m(np.asarray((stamps - START_NS) * 1e-9, np.float64)),
    )


def complete_topics(profile: Profile, distance: str = "/ground_truth/distance") -> dict[str, str]:
    """Topics by role: the profile's, or those of a dVRK where it leaves one open."""
    name = profile.instrument_name
    defaults = {
        "image": "/ECM/left/image",
        "camera_info": "/ECM/left/camera_info",
        "right_image": "/ECM/right/image",
        "right_camera_info": "/ECM/right/camera_info",
        "joints": f"/{name}/measured_js",
        "pose": f"/{name}/measured_cp",
        "tf": "/tf",
        "ground_truth_tf": "/ground_truth/tf",
        "ground_truth_distance": distance,
    }
    return {role: getattr(profile.topics, role) or topic for role, topic in defaults.items()}


def between_topic(first: str, second: str) -> str:
    """The topic of the true distances between two instruments."""
    return f"/ground_truth/{first}/{second}/distance"


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))
