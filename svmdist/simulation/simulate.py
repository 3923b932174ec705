"""The simulation itself: a scenario and a profile to the stream of samples that a log would hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import UsageError
from svmdist.kinematics.dh import forward_kinematics, link_transforms
from svmdist.profile import Profile, Simulation
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    ImageSample,
    JointSample,
    PoseSample,
    Sample,
    TransformSample,
    TransformsSample,
)
from svmdist.simulation.belief import Belief, draw_belief
from svmdist.simulation.clearance import ClearanceMeter
from svmdist.simulation.extras import Extras
from svmdist.simulation.renderer import Renderer
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Scene, make_scene
from svmdist.simulation.sensor import Sensor
from svmdist.simulation.trajectory import make_trajectory
from svmdist.transforms import Array

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
    joints: str
    pose: str
    tf: str
    ground_truth_tf: str
    ground_truth_distance: str


def topic_names(profile: Profile) -> TopicNames:
    """Take the profile's topic names, with defaults for those it leaves open."""
    topics = profile.topics
    return TopicNames(
        topics.image or "/ECM/left/image",
        topics.camera_info or "/ECM/left/camera_info",
        topics.right_image or "/ECM/right/image",
        topics.right_camera_info or "/ECM/right/camera_info",
        topics.joints or "/PSM1/measured_js",
        topics.pose or "/PSM1/measured_cp",
        topics.tf or "/tf",
        topics.ground_truth_tf or "/ground_truth/tf",
        topics.ground_truth_distance or "/ground_truth/distance",
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
    belief = draw_belief(scene.chain, scene.T_camera_base, profile, scenario.seed, extras.kinematic_error)
    with ClearanceMeter(scene) as meter, Renderer(scene, renderer) as view:
        trajectory = make_trajectory(
            scene, scenario, settings.working_height_m, np.clip(progress, 0.0, 1.0), meter
        )
        reported = trajectory.q + belief.joint_offsets
        with_image, with_joints = np.isin(stamps, images), np.isin(stamps, joints)
        next_camera_info_ns = START_NS
        for index, stamp in enumerate(stamps.tolist()):
            q = trajectory.q[index]
            if stamp >= next_camera_info_ns:
                yield topics.camera_info, CameraSample(stamp, scene.camera)
                if extras.stereo:
                    yield topics.right_camera_info, CameraSample(stamp, scene.right_camera)
                next_camera_info_ns += CAMERA_INFO_PERIOD_NS
            if with_joints[index]:
                yield topics.joints, JointSample(stamp, scene.chain.joint_names, reported[index])
                T_base_tool = forward_kinematics(scene.chain, reported[index])
                yield topics.pose, PoseSample(stamp, profile.frames.base, T_base_tool)
            truth = _true_transforms(scene, profile, stamp, q)
            yield topics.ground_truth_tf, truth
            yield topics.ground_truth_distance, _true_distances(truth, meter.clearance_m(q))
            if with_image[index]:
                yield topics.tf, _believed_transforms(scene, profile, belief, extras, stamp, reported[index])
                T_retractor = trajectory.T_world_retractor
                image = view.frame_of(q, None if T_retractor is None else T_retractor[index])
                yield (
                    topics.image,
                    ImageSample(stamp, scene.camera.frame_id, left.expose(image)),
                )
                if extras.stereo:
                    image = right.expose(view.right_frame())
                    yield topics.right_image, ImageSample(stamp, scene.right_camera.frame_id, image)


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _joint_stamps(scenario: Scenario, settings: Simulation) -> NDArray[np.int64]:
    """Joint stamps up to the end of the recording, so that every image lies between two of them."""
    count = int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1
    return _stamps(count, settings.joint_rate_hz)


def _true_transforms(scene: Scene, profile: Profile, stamp_ns: int, q: Array) -> TransformsSample:
    frames = profile.frames
    T_camera_tool = scene.T_camera_base @ forward_kinematics(scene.chain, q)
    return TransformsSample(
        stamp_ns,
        (
            TransformSample(stamp_ns, frames.camera, frames.tool, T_camera_tool),
            TransformSample(stamp_ns, frames.camera, frames.tissue, scene.T_camera_tissue),
        ),
    )


def _true_distances(truth: TransformsSample, clearance_m: float) -> DistanceSample:
    tool, tissue = (item.T_parent_child[:3, 3] for item in truth.transforms)
    between = tool - tissue
    return DistanceSample(
        truth.stamp_ns,
        planar_m=float(np.linalg.norm(between[:2])),  # eq. (35): in the camera's xy plane
        spatial_m=float(np.linalg.norm(between)),
        clearance_m=clearance_m,
    )


def _believed_transforms(
    scene: Scene, profile: Profile, belief: Belief, extras: Extras, stamp_ns: int, reported: Array
) -> TransformsSample:
    """The camera-to-base transform and the whole chain as the reported joints place it; the right camera."""
    frames, names = profile.frames, [row.name for row in scene.chain.rows]
    links = link_transforms(scene.chain, reported)
    children = [*names[:-1], frames.tool]
    parents = [frames.base, *names[:-1]]
    links[-1] = links[-1] @ scene.chain.T_last_tool
    chain = [
        TransformSample(stamp_ns, parent, child, T)
        for parent, child, T in zip(parents, children, links, strict=True)
    ]
    camera_base = TransformSample(stamp_ns, frames.camera, frames.base, belief.T_camera_base)
    if extras.stereo:
        right = scene.right_camera.frame_id
        chain.append(TransformSample(stamp_ns, frames.camera, right, scene.T_camera_right))
    return TransformsSample(stamp_ns, (camera_base, *chain))
