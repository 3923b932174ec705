"""One arm of a recording: what it does, and what it reports about that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from svmdist.kinematics.dh import forward_kinematics, link_transforms
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, JointSample, PoseSample, Sample, TransformSample
from svmdist.simulation.nominal import NominalKinematics
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array


@dataclass(frozen=True)
class ArmTopicNames:
    """The topics of one simulated arm."""

    joints: str
    pose: str
    ground_truth_distance: str


@dataclass(frozen=True)
class ArmPoses:
    """An arm over k stamps: reported joints (k, n_joints), nominal `T_base_tool` and true `T_camera_tool` (k, 4, 4)."""

    reported: Array
    T_base_tool: Array
    T_camera_tool: Array


@dataclass(frozen=True)
class Arm:
    """An arm of a scene: profile and scene as it sees them, its topics, its exact joints (n, n_joints) at all stamps.

    `reported` are the joints that it reports at the same stamps, (n, n_joints). `prefix` stands before the names of its
    links in transforms; the first arm's have none.
    """

    profile: Profile
    scene: Scene
    topics: ArmTopicNames
    q: Array
    nominal: NominalKinematics
    reported: Array
    prefix: str = ""

    def poses(self, begin: int, end: int) -> ArmPoses:
        """Where the arm is, and where it reports to be, from one stamp to before another."""
        q, reported = self.q[begin:end], self.reported[begin:end]
        return ArmPoses(
            reported,
            forward_kinematics(self.nominal.chain, reported),
            self.scene.T_camera_base @ forward_kinematics(self.scene.chain, q),
        )

    def reports(self, stamp_ns: int, poses: ArmPoses, at: int) -> Iterator[tuple[str, Sample]]:
        """Joints and pose as the encoders have them at the stamp number `at` of the poses."""
        names = self.scene.chain.joint_names
        yield self.topics.joints, JointSample(stamp_ns, names, poses.reported[at])
        yield self.topics.pose, PoseSample(stamp_ns, self.profile.frames.base, poses.T_base_tool[at])

    def true_transform(self, stamp_ns: int, poses: ArmPoses, at: int) -> TransformSample:
        """Where the tool is."""
        frames = self.profile.frames
        return TransformSample(stamp_ns, frames.camera, frames.tool, poses.T_camera_tool[at])

    def true_distances(
        self, tool: TransformSample, tissue: TransformSample, clearance_m: float
    ) -> tuple[str, DistanceSample]:
        """How far the tool is from the tissue."""
        between = tool.T_parent_child[:3, 3] - tissue.T_parent_child[:3, 3]
        return self.topics.ground_truth_distance, distances(tool.stamp_ns, between, clearance_m)

    def nominal_transforms(self, stamp_ns: int, poses: ArmPoses, at: int) -> tuple[TransformSample, ...]:
        """The nominal camera-to-base transform, then the whole chain as the reported joints place it."""
        frames, chain = self.profile.frames, self.nominal.chain
        names = [self.prefix + row.name for row in chain.rows]
        links = link_transforms(chain, poses.reported[at])
        children = [*names[:-1], frames.tool]
        parents = [frames.base, *names[:-1]]
        links[-1] = links[-1] @ chain.T_last_tool
        return (
            TransformSample(stamp_ns, frames.camera, frames.base, self.nominal.T_camera_base),
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
