"""One arm of a recording: what it does, what it believes, and what it says about both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from svmdist.kinematics.dh import forward_kinematics, link_transforms
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, JointSample, PoseSample, Sample, TransformSample
from svmdist.simulation.belief import Belief
from svmdist.simulation.clearance.blocks import Blocks
from svmdist.simulation.clearance.meters import ClearanceMeter
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array


@dataclass(frozen=True)
class ArmTopicNames:
    """The topics of one simulated arm."""

    joints: str
    pose: str
    ground_truth_distance: str


@dataclass(frozen=True)
class Arm:
    """An arm of a scene: profile and scene as it sees them, its topics, its exact joints (n, n_joints), its belief.

    `prefix` stands before the names of its links in transforms; the first arm's have none.
    """

    profile: Profile
    scene: Scene
    topics: ArmTopicNames
    q: Array
    belief: Belief
    meter: ClearanceMeter
    prefix: str = ""

    def reports(self, stamp_ns: int, index: int) -> Iterator[tuple[str, Sample]]:
        """Joints and pose as the encoders have them."""
        reported = self.q[index] + self.belief.joint_offsets
        yield self.topics.joints, JointSample(stamp_ns, self.scene.chain.joint_names, reported)
        T_base_tool = forward_kinematics(self.scene.chain, reported)
        yield self.topics.pose, PoseSample(stamp_ns, self.profile.frames.base, T_base_tool)

    def true_transform(self, stamp_ns: int, index: int) -> TransformSample:
        """Where the tool is."""
        frames = self.profile.frames
        T_camera_tool = self.scene.T_camera_base @ forward_kinematics(self.scene.chain, self.q[index])
        return TransformSample(stamp_ns, frames.camera, frames.tool, T_camera_tool)

    def true_distances(self, tool: TransformSample, index: int) -> tuple[str, DistanceSample]:
        """How far the tool is from the tissue."""
        between = tool.T_parent_child[:3, 3] - self.scene.T_camera_tissue[:3, 3]
        return self.topics.ground_truth_distance, distances(tool.stamp_ns, between, self._clearances_m[index])

    @cached_property
    def _clearances_m(self) -> Blocks:
        return Blocks(self.meter.clearances_m, self.q)

    def believed_transforms(self, stamp_ns: int, index: int) -> tuple[TransformSample, ...]:
        """The camera-to-base transform, then the whole chain as the reported joints place it."""
        frames, chain = self.profile.frames, self.scene.chain
        names = [self.prefix + row.name for row in chain.rows]
        links = link_transforms(chain, self.q[index] + self.belief.joint_offsets)
        children = [*names[:-1], frames.tool]
        parents = [frames.base, *names[:-1]]
        links[-1] = links[-1] @ chain.T_last_tool
        return (
            TransformSample(stamp_ns, frames.camera, frames.base, self.belief.T_camera_base),
            *(
                TransformSample(stamp_ns, parent, child, T)
                for parent, child, T in zip(parents, children, links, strict=True)
            ),
        )


def distances(stamp_ns: int, between_m: Array, clearance_m: float) -> DistanceSample:
    """The three distances of two things, by the vector between their origins in the camera frame, shape (3,)."""
    return DistanceSample(
        stamp_ns,
        planar_m=float(np.linalg.norm(between_m[:2])),  # eq. (35): in the camera's xy plane
        spatial_m=float(np.linalg.norm(between_m)),
        clearance_m=clearance_m,
    )
