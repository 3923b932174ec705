"""The plan of a recording: all that is settled before the first image, and its division into blocks.

A plan holds no physics world and can be sent to another process. A block is one image with all samples up to the
next; each can be made by itself, so that the content does not depend on who makes it, or in which order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import UsageError
from svmdist.kinematics.dh import chain_of
from svmdist.perturbations.shape import built_profile
from svmdist.profile import Profile, Simulation
from svmdist.simulation.arm import Arm, ArmTopicNames
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.motion.trajectory import make_trajectory
from svmdist.simulation.nominal import NominalKinematics, draw_nominal_kinematics
from svmdist.simulation.reports import reported_joints
from svmdist.simulation.room.jaw import untold_opening_rad
from svmdist.simulation.room.tissue_motion import tissue_rise_m
from svmdist.simulation.scene import Scene, make_scene
from svmdist.simulation.second_arm import OtherArm, make_other_arms
from svmdist.transforms import Array

START_NS = 1_700_000_000_000_000_000
"""The stamp of the first sample. No clock is read, so that a rerun gives the same log."""
CAMERA_INFO_PERIOD_NS = 1_000_000_000
MAX_NOISE_LEVELS = 64.0


@dataclass(frozen=True)
class TopicNames:
    """The topics of a simulated log: the profile's names, else those of a dVRK."""

    image: str
    camera_info: str
    right_image: str
    right_camera_info: str
    arm: ArmTopicNames
    tf: str
    ground_truth_tf: str


@dataclass(frozen=True)
class Block:
    """The stamps from number `begin` to before `end`; the first of them is that of image number `frame`."""

    frame: int
    begin: int
    end: int


@dataclass(frozen=True)
class Moment:
    """What stands where: joints of each arm, (n_joints,), the retractor's pose, (4, 4), the tissue's rise in m."""

    q: tuple[Array, ...]
    T_world_retractor: Array | None
    rise_m: float


@dataclass(frozen=True)
class Plan:
    """A recording before it is made.

    All arrays have one entry for each stamp: `stamps_ns` (n,), whether an image, joints or the cameras' calibration
    come with it (n,), the retractor's poses (n, 4, 4), or None where there is none, and how far the tissue has risen
    (n,), or None where it holds still. The first arm's scene is the world's.
    """

    profile: Profile
    scene: Scene
    arms: tuple[Arm, ...]
    topics: TopicNames
    seed: int
    renderer: str
    noise: float
    extras: Extras
    stamps_ns: NDArray[np.int64]
    with_image: NDArray[np.bool_]
    with_joints: NDArray[np.bool_]
    with_camera_info: NDArray[np.bool_]
    T_world_retractor: Array | None
    tissue_rise_m: Array | None = None

    @property
    def blocks(self) -> list[Block]:
        """All blocks in the order of time; the first image has the first stamp."""
        begins = np.nonzero(self.with_image)[0].tolist()
        ends = [*begins[1:], len(self.stamps_ns)]
        return [Block(frame, *span) for frame, span in enumerate(zip(begins, ends, strict=True))]

    def moment(self, index: int, after_ns: float = 0.0) -> Moment:
        """What stands where at the stamp number `index`, or so much later: on a straight line between two stamps.

        So it is before the first stamp: the robot moved before the recording, too. After the last one it holds still.
        """
        if not after_ns:
            return self._moment(lambda values: values[index])
        since_ns = self.stamps_ns - self.stamps_ns[index]  # stamps are too large for a float
        above = int(np.clip(np.searchsorted(since_ns, after_ns), 1, len(since_ns) - 1))
        below = above - 1
        share = min((after_ns - since_ns[below]) / (since_ns[above] - since_ns[below]), 1.0)
        return self._moment(lambda values: values[below] + share * (values[above] - values[below]))

    def _moment(self, at: Callable[[Array], Array]) -> Moment:
        return Moment(
            tuple(at(arm.q) for arm in self.arms),
            # The retractor's blade slides, and never turns.
            None if self.T_world_retractor is None else at(self.T_world_retractor),
            0.0 if self.tissue_rise_m is None else float(at(self.tissue_rise_m)),
        )


def make_plan(
    scenario: Scenario,
    profile: Profile,
    *,
    renderer: str = "tiny",
    noise: float = 0.0,
    extras: Extras | None = None,
) -> Plan:
    """Plan a recording; `noise` is a standard deviation in 8-bit levels.

    Joints, poses and truth come at the profile's joint rate and at every image's stamp exactly (truth only).
    Raises UsageError for noise out of range, and SimulationError where PyBullet is missing and needed, or the profile
    cannot be simulated.
    """
    if not 0.0 <= noise <= MAX_NOISE_LEVELS:
        raise UsageError(
            f"noise is a standard deviation from 0 to {MAX_NOISE_LEVELS:g} levels, found {noise:g}"
        )
    extras = extras or Extras()
    built = built_profile(profile, extras.perturbations, scenario.seed)
    scene = make_scene(built, scenario.seed, extras)
    settings = built.simulation
    assert settings is not None  # make_scene has checked it
    room = scene.room
    images, joints = _stamps(scenario.frame_count, scenario.rate_hz), _joint_stamps(scenario, settings)
    stamps = np.union1d(images, joints)
    progress = np.clip((stamps - START_NS) / (scenario.duration_s * 1e9), 0.0, 1.0)
    trajectory = make_trajectory(scene, scenario, settings.working_height_m, progress)
    topics = topic_names(profile)
    with_joints = np.isin(stamps, joints)
    reporting = _Reporting(stamps, with_joints, progress * scenario.duration_s, scenario.seed, extras)
    first = reporting.arm(0, profile, scene, topics.arm, trajectory.q)
    others: tuple[OtherArm, ...] = ()
    if extras.arms > 1:
        others = make_other_arms(built, scene, scenario.seed, extras, first.q, progress, scenario.duration_s)
    arms = (
        first,
        *(_further_arm(profile, other, reporting, index) for index, other in enumerate(others, start=1)),
    )
    return Plan(
        profile=profile,
        scene=scene,
        arms=arms,
        topics=topics,
        seed=scenario.seed,
        renderer=renderer,
        noise=noise,
        extras=extras,
        stamps_ns=stamps,
        with_image=np.isin(stamps, images),
        with_joints=with_joints,
        with_camera_info=_first_of_each_period(stamps),
        T_world_retractor=trajectory.T_world_retractor,
        tissue_rise_m=(
            tissue_rise_m(room, scenario.seed, np.asarray((stamps - START_NS) * 1e-9, np.float64))
            if room.moves_tissue
            else None
        ),
    )


def topic_names(profile: Profile) -> TopicNames:
    """Take the profile's topic names, with defaults for those it leaves open."""
    topics = profile.topics
    return TopicNames(
        topics.image or "/ECM/left/image",
        topics.camera_info or "/ECM/left/camera_info",
        topics.right_image or "/ECM/right/image",
        topics.right_camera_info or "/ECM/right/camera_info",
        _arm_topic_names(profile, "/ground_truth/distance"),
        topics.tf or "/tf",
        topics.ground_truth_tf or "/ground_truth/tf",
    )


def between_topic(first: str, second: str) -> str:
    """The topic of the true distances between two instruments."""
    return f"/ground_truth/{first}/{second}/distance"


def _arm_topic_names(profile: Profile, distance: str) -> ArmTopicNames:
    topics, name = profile.topics, profile.instrument_name
    return ArmTopicNames(
        topics.joints or f"/{name}/measured_js",
        topics.pose or f"/{name}/measured_cp",
        topics.ground_truth_distance or distance,
    )


@dataclass(frozen=True)
class _Reporting:
    """Makes arms of a recording that report at the stamps, shape (n,), their joints at some of them.

    `path_s`, shape (n,), is how far in time their paths are.
    """

    stamps_ns: NDArray[np.int64]
    with_joints: NDArray[np.bool_]
    path_s: Array
    seed: int
    extras: Extras

    def arm(
        self, number: int, profile: Profile, scene: Scene, topics: ArmTopicNames, q: Array, prefix: str = ""
    ) -> Arm:
        """The arm of a number that moves by `q`, shape (n, n_joints), and takes itself for the profile's."""
        nominal = self._nominal(number, profile, scene)
        exact = q + nominal.joint_offsets
        if scene.room.jaw:
            exact[:, -1] -= untold_opening_rad(scene.room, self.seed, self.path_s, number)
        reported = reported_joints(
            exact, self.stamps_ns, self.with_joints, profile, self.extras.perturbations, self.seed, number
        )
        return Arm(profile, scene, topics, q, nominal, reported, prefix)

    def _nominal(self, number: int, profile: Profile, scene: Scene) -> NominalKinematics:
        assert profile.robot is not None  # the scene has checked it
        return draw_nominal_kinematics(
            chain_of(profile.robot),
            scene.T_camera_base,
            profile,
            self.seed,
            self.extras.kinematic_error,
            arm=(number,) if number else (),
        )


def _further_arm(profile: Profile, other: OtherArm, reporting: _Reporting, number: int) -> Arm:
    view = profile.for_instrument(other.name)
    topics = _arm_topic_names(view, f"/ground_truth/{other.name}/distance")
    return reporting.arm(number, view, other.scene, topics, other.q, prefix=f"{other.name}_")


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _joint_stamps(scenario: Scenario, settings: Simulation) -> NDArray[np.int64]:
    """Joint stamps up to the end of the recording, so that every image lies between two of them."""
    count = int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1
    return _stamps(count, settings.joint_rate_hz)


def _first_of_each_period(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which stamps are the first at or after a multiple of the cameras' period; shape (n,).

    A stamp stands for one period at most: after a gap of several, those after it make up for them.
    """
    chosen = np.zeros(len(stamps), np.bool_)
    next_ns = START_NS
    for index, stamp in enumerate(stamps.tolist()):
        if stamp >= next_ns:
            chosen[index] = True
            next_ns += CAMERA_INFO_PERIOD_NS
    return chosen
