"""Small logs drawn with OpenCV: a red ellipse, a cyan disc where the robot's tool projects, and their truth.

They stand in for recordings where a test needs a log but no simulator: their geometry is exact, made from
the shipped chain, and a frame costs a millisecond.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.kinematics import DHChain, forward_kinematics
from svmdist.profile import Profile
from svmdist.recording.writer import EncodedSample, RecordingWriter
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    Image,
    ImageSample,
    JointSample,
    Sample,
    TransformSample,
    TransformsSample,
)
from svmdist.transforms import Array, inverse, make_transform, rotation_z
from tests.shipped import CHAIN, POSTURE, PROFILE

START_NS = 1_700_000_000_000_000_000
TOOL_DEPTH_M = 0.09
TISSUE_M = np.array([0.002, -0.001, TOOL_DEPTH_M])
"""The tissue's origin in the camera frame, at the depth of the tool: these logs have no parallax."""


@dataclass(frozen=True)
class SyntheticScene:
    """The geometry of a synthetic log: the set-up arm's vertical axes move the tool in the camera's plane."""

    profile: Profile
    camera: Camera
    chain: DHChain
    T_camera_base: Array

    def joints_at(self, seconds: float) -> Array:
        """Joint values, shape (n_joints,), at a time: a small figure around the middle of the work space."""
        q = POSTURE.copy()
        names = self.chain.joint_names
        q[names.index("setup_2")] += 0.021 * np.sin(1.9 * seconds)
        q[names.index("setup_3")] += 0.038 * np.sin(2.7 * seconds + 0.4)
        return q

    def T_camera_tool_at(self, seconds: float) -> Array:
        """The tool's pose in the camera frame, shape (4, 4)."""
        return self.T_camera_base @ forward_kinematics(self.chain, self.joints_at(seconds))

    def frame_at(self, seconds: float) -> Image:
        """Draw the scene."""
        image = np.full((self.camera.height_px, self.camera.width_px, 3), (118, 126, 134), np.uint8)
        image += (np.indices(image.shape[:2]).sum(0) // 60 % 12).astype(np.uint8)[..., None]
        _disc(image, self.camera.project(TISSUE_M)[0], 90.0, (60, 50, 200))
        _disc(image, self.camera.project(self.T_camera_tool_at(seconds)[:3, 3])[0], 9.0, (180, 180, 20))
        return image


def make_scene(width_px: int = 640, height_px: int = 480) -> SyntheticScene:
    """Place the base so that the tool's middle pose lies straight before the camera."""
    camera = Camera.from_horizontal_fov(width_px, height_px, np.pi / 3)
    T_base_tool = forward_kinematics(CHAIN, POSTURE)
    # Half way between the axes, so that the arm's swing covers columns and rows alike.
    R_camera_base = np.diag([1.0, -1.0, -1.0]) @ rotation_z(np.pi / 4)
    T_camera_tool = make_transform(R_camera_base @ T_base_tool[:3, :3], [0.006, 0.002, TOOL_DEPTH_M])
    return SyntheticScene(PROFILE, camera, CHAIN, T_camera_tool @ inverse(T_base_tool))


def samples(scene: SyntheticScene, frame_count: int, rate_hz: float = 10.0) -> Iterator[tuple[str, Sample]]:
    """Yield topics and samples of a log in the order of their stamps: joints and truth at 100 Hz."""
    topics, frames = scene.profile.topics, scene.profile.frames
    joint_steps = round(frame_count / rate_hz * 100)
    stride = round(100 / rate_hz)
    yield str(topics.camera_info), CameraSample(START_NS, scene.camera)
    for step in range(joint_steps + 1):
        stamp_ns, seconds = START_NS + step * 10_000_000, step / 100
        T_camera_tool = scene.T_camera_tool_at(seconds)
        yield str(topics.joints), JointSample(stamp_ns, scene.chain.joint_names, scene.joints_at(seconds))
        yield (
            str(topics.tf),
            TransformsSample(stamp_ns, (TransformSample(stamp_ns, frames.camera, frames.base, scene.T_camera_base),)),
        )
        yield (
            str(topics.ground_truth_tf),
            TransformsSample(
                stamp_ns,
                (
                    TransformSample(stamp_ns, frames.camera, frames.tool, T_camera_tool),
                    TransformSample(stamp_ns, frames.camera, frames.tissue, make_transform(np.eye(3), TISSUE_M)),
                ),
            ),
        )
        offset_m = T_camera_tool[:3, 3] - TISSUE_M
        spatial_m = float(np.linalg.norm(offset_m))
        yield (
            str(topics.ground_truth_distance),
            DistanceSample(stamp_ns, float(np.hypot(*offset_m[:2])), spatial_m, spatial_m - 0.01),
        )
        if step % stride == 0 and step // stride < frame_count:
            yield str(topics.image), ImageSample(stamp_ns, frames.camera, scene.frame_at(seconds))


def write_log(
    path: Path,
    scene: SyntheticScene | None = None,
    frame_count: int = 20,
    change: Callable[[str, Sample], Sample | None] = lambda topic, sample: sample,
    metadata: Mapping[str, str] = {"scenario": "synthetic"},
) -> Path:
    """Write a synthetic log; `change` may alter each sample, or drop it by giving None."""
    pairs = samples(scene or make_scene(), frame_count)
    changed = ((topic, change(topic, sample)) for topic, sample in pairs)
    return write_samples(path, ((topic, sample) for topic, sample in changed if sample is not None), metadata)


def write_samples(
    path: Path, pairs: Iterable[tuple[str, Sample | EncodedSample]], metadata: Mapping[str, str] = {}
) -> Path:
    """Write samples, each behind its topic, in their order."""
    with RecordingWriter(path, metadata) as writer:
        for topic, sample in pairs:
            writer.write(topic, sample)
    return path


def right_of(camera: Camera, baseline_m: float = 0.005) -> Camera:
    """The right camera of a rectified pair with a left one."""
    P = np.hstack([camera.K, [[-baseline_m * camera.K[0, 0]], [0.0], [0.0]]])
    return replace(camera, P=P, frame_id="camera_right")


def tracked(topic: str, sample: Sample) -> Sample:
    """A change that adds tool and tissue to the transforms, as a tracking system would publish them."""
    if topic != "/tf" or not isinstance(sample, TransformsSample):
        return sample
    stamp_ns = sample.stamp_ns
    T_camera_tool = make_scene().T_camera_tool_at((stamp_ns - START_NS) / 1e9)
    poses = (("tool", T_camera_tool), ("tissue", make_transform(rotation_z(0.3), TISSUE_M)))
    added = tuple(TransformSample(stamp_ns, "camera", child, T) for child, T in poses)
    return replace(sample, transforms=(*sample.transforms, *added))


def without(part: str) -> Callable[[str, Sample], Sample | None]:
    """A change that drops the topics with this part in their names."""
    return lambda topic, sample: None if part in topic else sample


def _disc(image: Image, centre_px: Array, radius_px: float, colour: tuple[int, int, int]) -> None:
    fixed = np.round(centre_px * 16).astype(int)
    cv2.circle(image, (int(fixed[0]), int(fixed[1])), round(radius_px * 16), colour, -1, cv2.LINE_8, 4)
