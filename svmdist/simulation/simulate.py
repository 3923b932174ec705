"""The simulation itself: a scenario and a profile to the stream of samples that a log would hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import UsageError
from svmdist.profile import Profile, Simulation
from svmdist.samples import (
    CameraSample,
    ImageSample,
    Sample,
    TransformSample,
    TransformsSample,
)
from svmdist.simulation.arm import Arm, ArmTopicNames, distances
from svmdist.simulation.belief import draw_belief
from svmdist.simulation.clearance.blocks import Blocks
from svmdist.simulation.clearance.meters import BetweenMeter, ClearanceMeter
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.motion.trajectory import make_trajectory
from svmdist.simulation.renderer import Renderer
from svmdist.simulation.scene import Scene, make_scene
from svmdist.simulation.second_arm import OtherArm, make_other_arms
from svmdist.simulation.sensor import Sensor

START_NS = 1_700_000_000_000_000_000
"""The stamp of the first sample. No clock is read, so that a rerun gives the same log."""
CAMERA_INFO_PERIOD_NS = 1_000_000_000


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


def simulate(
    scenario: Scenario,
    profile: Profile,
    *,
    renderer: str = "tiny",
    noise: float = 0.0,
    extras: Extras | None = None,
) -> Iterator[tuple[str, Sample]]:
    """Yield (topic, sample) in the order of time; `noise` is a standard deviation in 8-bit levels.

    Joints, poses and truth come at the profile's joint rate and at every image's stamp exactly (truth only).
    Raises SimulationError where PyBullet is missing or the profile cannot be simulated.
    """
    if not 0.0 <= noise <= 64.0:
        raise UsageError(f"noise is a standard deviation from 0 to 64 levels, found {noise:g}")
    extras = extras or Extras()
    scene = make_scene(profile, scenario.seed, extras)
    settings = profile.simulation
    assert settings is not None  # make_scene has checked it
    images, joints = _stamps(scenario.frame_count, scenario.rate_hz), _joint_stamps(scenario, settings)
    stamps = np.union1d(images, joints)
    progress = (stamps - START_NS) / (scenario.duration_s * 1e9)
    topics = topic_names(profile)
    left, right = (Sensor(eye, scenario.seed, noise, extras) for eye in (0, 1))
    with ExitStack() as stack:
        meter = stack.enter_context(ClearanceMeter(scene))
        trajectory = make_trajectory(
            scene, scenario, settings.working_height_m, np.clip(progress, 0.0, 1.0), meter
        )
        belief = draw_belief(scene.chain, scene.T_camera_base, profile, scenario.seed, extras.kinematic_error)
        first = Arm(profile, scene, topics.arm, trajectory.q, belief, meter)
        others = [
            _further_arm(other, index, scenario.seed, extras, stack)
            for index, other in enumerate(_plan_others(first, scenario, extras, progress), start=1)
        ]
        arms = (first, *others)
        between_m = [
            Blocks(stack.enter_context(BetweenMeter(scene, other.scene)).clearances_m, first.q, other.q)
            for other in others
        ]
        view = stack.enter_context(Renderer(scene, renderer, [other.scene for other in others]))
        with_image, with_joints = np.isin(stamps, images), np.isin(stamps, joints)
        next_camera_info_ns = START_NS
        for index, stamp in enumerate(stamps.tolist()):
            if stamp >= next_camera_info_ns:
                yield topics.camera_info, CameraSample(stamp, scene.camera)
                if extras.stereo:
                    yield topics.right_camera_info, CameraSample(stamp, scene.right_camera)
                next_camera_info_ns += CAMERA_INFO_PERIOD_NS
            if with_joints[index]:
                for arm in arms:
                    yield from arm.reports(stamp, index)
            tools = [arm.true_transform(stamp, index) for arm in arms]
            yield topics.ground_truth_tf, _true_transforms(scene, profile, tools)
            for arm, tool in zip(arms, tools, strict=True):
                yield arm.true_distances(tool, index)
            for other, tool, clearances_m in zip(others, tools[1:], between_m, strict=True):
                offset_m = tools[0].T_parent_child[:3, 3] - tool.T_parent_child[:3, 3]
                topic = between_topic(profile.instrument_name, other.profile.instrument_name)
                yield topic, distances(stamp, offset_m, clearances_m[index])
            if with_image[index]:
                yield topics.tf, _believed_transforms(arms, extras, stamp, index)
                T_retractor = trajectory.T_world_retractor
                image = view.frame_of(
                    first.q[index],
                    None if T_retractor is None else T_retractor[index],
                    [other.q[index] for other in others],
                )
                yield (
                    topics.image,
                    ImageSample(stamp, scene.camera.frame_id, left.expose(image)),
                )
                if extras.stereo:
                    image = right.expose(view.right_frame())
                    yield topics.right_image, ImageSample(stamp, scene.right_camera.frame_id, image)


def _plan_others(
    first: Arm, scenario: Scenario, extras: Extras, progress: NDArray[np.float64]
) -> tuple[OtherArm, ...]:
    if extras.arms == 1:
        return ()
    moments = np.clip(progress, 0.0, 1.0)
    return make_other_arms(
        first.profile, first.scene, scenario.seed, extras, first.q, moments, scenario.duration_s
    )


def _further_arm(other: OtherArm, index: int, seed: int, extras: Extras, stack: ExitStack) -> Arm:
    scene, profile = other.scene, other.profile
    belief = draw_belief(
        scene.chain, scene.T_camera_base, profile, seed, extras.kinematic_error, arm=(index,)
    )
    topics = _arm_topic_names(profile, f"/ground_truth/{other.name}/distance")
    meter = stack.enter_context(ClearanceMeter(scene))
    return Arm(profile, scene, topics, other.q, belief, meter, prefix=f"{other.name}_")


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _joint_stamps(scenario: Scenario, settings: Simulation) -> NDArray[np.int64]:
    """Joint stamps up to the end of the recording, so that every image lies between two of them."""
    count = int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1
    return _stamps(count, settings.joint_rate_hz)


def _true_transforms(scene: Scene, profile: Profile, tools: list[TransformSample]) -> TransformsSample:
    frames, stamp_ns = profile.frames, tools[0].stamp_ns
    tissue = TransformSample(stamp_ns, frames.camera, frames.tissue, scene.T_camera_tissue)
    return TransformsSample(stamp_ns, (tools[0], tissue, *tools[1:]))


def _believed_transforms(
    arms: tuple[Arm, ...], extras: Extras, stamp_ns: int, index: int
) -> TransformsSample:
    """The transforms of the first arm, the right camera, and those of the other arms."""
    transforms = [arm.believed_transforms(stamp_ns, index) for arm in arms]
    right = []
    if extras.stereo:
        scene = arms[0].scene
        camera, right_frame = scene.camera.frame_id, scene.right_camera.frame_id
        right = [TransformSample(stamp_ns, camera, right_frame, scene.T_camera_right)]
    return TransformsSample(
        stamp_ns, (*transforms[0], *right, *(sample for other in transforms[1:] for sample in other))
    )
