"""Images and what belongs to them, in one streaming pass with a bounded look-ahead.

That is the joints and the nominal camera pose of every arm at the image's stamp, and the other image of a stereo
pair.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from svmdist.recording.arms import FixedTransform
from svmdist.recording.latest import Latest
from svmdist.recording.messages.checks import EncodedImage, RawTransforms
from svmdist.recording.messages.images import ImageError
from svmdist.recording.transform_buffer import TransformBuffer
from svmdist.samples import JointSample
from svmdist.tracks import JointTrack
from svmdist.transforms import Array

LOOK_AHEAD_NS = 3_000_000_000
"""How long, in log time, an image waits for the joints behind its stamp: clocks may differ by seconds."""
MAX_WAITING_BYTES = 64 << 20
MAX_JOINT_SAMPLES = 5_000
"""Five seconds of joints at 1 kHz, and 2 MB: images may be stamped that much before the joints around them."""
JOINT_TRACK_NS = 200_000_000
"""Joints so long before and after an image go with it: by as much the clocks may differ for a method that finds it."""
PAIR_TOLERANCE_NS = 500_000
"""Cameras of a pair are triggered together: half a millisecond is less than any exposure."""


@dataclass(frozen=True, slots=True)
class LoggedImage:
    """An image message, where and when it was logged."""

    log_time_ns: int
    size_bytes: int
    offset: int | None
    image: EncodedImage


@dataclass(frozen=True, slots=True)
class RightImage:
    """An image message of the right camera."""

    logged: LoggedImage


@dataclass(frozen=True, slots=True)
class LoggedTransforms:
    """A message of transforms, and whether they hold for the whole log."""

    stated: RawTransforms
    is_static: bool


@dataclass(frozen=True, slots=True)
class LoggedJoints:
    """A joint sample, and which of the arms it is of."""

    sample: JointSample
    arm: int


@dataclass(frozen=True, slots=True)
class ArmState:
    """What one arm reported at an image's stamp."""

    joints: JointSample | None
    T_camera_base: Array | None
    joint_track: JointTrack | None = None


@dataclass(frozen=True, slots=True)
class Matched:
    """An image with what was found at its stamp, for each arm."""

    logged: LoggedImage
    right: LoggedImage | None
    arms: tuple[ArmState, ...]


Item = LoggedImage | RightImage | LoggedJoints | LoggedTransforms


class JointBuffer:
    """The latest joint samples of one arm."""

    def __init__(self) -> None:
        self._samples: Latest[JointSample] = Latest()

    @property
    def newest_ns(self) -> int:
        """Largest stamp, -1 where there is none."""
        return self._samples.newest_ns

    def add(self, sample: JointSample) -> None:
        """Put a sample in its place; one with the same stamp is replaced."""
        self._samples.add(sample.stamp_ns, sample, MAX_JOINT_SAMPLES)

    def at(self, stamp_ns: int) -> JointSample | None:
        """Interpolate linearly; None outside the samples, and in a gap longer than 0.1 s."""
        stamps_ns, near = self._samples.around(stamp_ns)
        if not near or near[0].names != near[-1].names:
            return None
        positions = np.array([sample.positions for sample in near])
        track = JointTrack(np.array(stamps_ns, np.int64), near[0].names, positions)
        sampled = track.at(np.array([stamp_ns], np.int64))
        return JointSample(stamp_ns, track.names, sampled.values[0]) if sampled.valid[0] else None

    def track_around(self, stamp_ns: int) -> JointTrack | None:
        """The samples within `JOINT_TRACK_NS` of a stamp; None without one, or where their names differ."""
        stamps_ns, near = self._samples.between(stamp_ns - JOINT_TRACK_NS, stamp_ns + JOINT_TRACK_NS)
        if not near or any(sample.names != near[0].names for sample in near):
            return None
        positions = np.array([sample.positions for sample in near])
        return JointTrack(np.array(stamps_ns, np.int64), near[0].names, positions)


class RightBuffer:
    """Right images that wait for their left ones, still encoded; beyond 64 MiB the oldest are forgotten."""

    def __init__(self) -> None:
        self._images: deque[LoggedImage] = deque()
        self._size_bytes = 0
        self.newest_ns = -1

    def add(self, logged: LoggedImage) -> None:
        """Take up an image."""
        self._images.append(logged)
        self._size_bytes += logged.size_bytes
        self.newest_ns = max(self.newest_ns, logged.image.stamp_ns)
        while len(self._images) > 1 and self._size_bytes > MAX_WAITING_BYTES:
            self._pass_over()

    def take(self, stamp_ns: int) -> LoggedImage | None:
        """Hand out the image nearest to a stamp, once; None where none is within half a millisecond.

        Frames of a video are handed out in file order: one that was passed over is gone.
        """
        near = [
            logged for logged in self._images if abs(logged.image.stamp_ns - stamp_ns) <= PAIR_TOLERANCE_NS
        ]
        if not near:
            return None
        nearest = min(near, key=lambda logged: abs(logged.image.stamp_ns - stamp_ns))
        if nearest.image.is_ordered:
            while self._images[0] is not nearest:
                self._pass_over()
        self._images.remove(nearest)
        self._size_bytes -= nearest.size_bytes
        return nearest

    def _pass_over(self) -> None:
        """Forget the oldest image; a frame of a video is decoded first, for the next ones refer to it."""
        oldest = self._images.popleft()
        self._size_bytes -= oldest.size_bytes
        if oldest.image.is_ordered:
            with suppress(ImageError):
                oldest.image.decode()


class ArmBuffer:
    """The latest joints and transforms of one arm; `has_joints` says that images wait for joints of it.

    `fixed` stands for the transforms where it is given.
    """

    def __init__(
        self, transforms: TransformBuffer, *, has_joints: bool, fixed: FixedTransform | None = None
    ) -> None:
        self.joints = JointBuffer()
        self.transforms = transforms
        self.has_joints = has_joints
        self.fixed = fixed

    def at(self, stamp_ns: int) -> ArmState:
        """What the arm reported at a stamp."""
        joints = self.joints.at(stamp_ns)
        track = None if joints is None else self.joints.track_around(stamp_ns)
        T_camera_base = self.transforms.at(stamp_ns) if self.fixed is None else self.fixed.T_camera_base
        return ArmState(joints, T_camera_base, track)


class Matcher:
    """Finds what belongs to an image; images wait for right images and for transforms where there are any."""

    def __init__(
        self, arms: Sequence[ArmBuffer], *, has_right: bool, has_transforms: bool, lag_ns: int = 0
    ) -> None:
        self._arms = tuple(arms)
        # Joints that are stamped late may be logged late, too.
        self._look_ahead_ns = LOOK_AHEAD_NS + max(0, -lag_ns)
        self._right = RightBuffer()
        self._has_right = has_right
        self._has_transforms = has_transforms
        self._waiting: deque[LoggedImage] = deque()
        self._waiting_bytes = 0

    def match(self, items: Iterable[Item]) -> Iterator[Matched]:
        """Yield every image in order with what is known at its stamp; items come in file order."""
        for item in items:
            self._take_up(item)
            while self._waiting and (self._waiting_bytes > MAX_WAITING_BYTES or self._is_ready()):
                ready = self._waiting.popleft()
                self._waiting_bytes -= ready.size_bytes
                yield self._matched(ready)
        for left in self._waiting:
            yield self._matched(left)

    def _take_up(self, item: Item) -> None:
        match item:
            case LoggedImage():
                self._waiting.append(item)
                self._waiting_bytes += item.size_bytes
            case RightImage(logged=logged):
                self._right.add(logged)
            case LoggedJoints(sample=joints, arm=arm):
                self._arms[arm].joints.add(joints)
            case LoggedTransforms(stated=stated, is_static=is_static):
                for transform in stated.transforms:
                    for buffer in self._arms:
                        buffer.transforms.add(transform, is_static=is_static)

    def _is_ready(self) -> bool:
        first = self._waiting[0]
        if self._waiting[-1].log_time_ns - first.log_time_ns > self._look_ahead_ns:
            return True
        newest_ns = [self._right.newest_ns] if self._has_right else []
        newest_ns += [arm.joints.newest_ns - JOINT_TRACK_NS for arm in self._arms if arm.has_joints]
        waiting = [arm for arm in self._arms if self._has_transforms and arm.fixed is None]
        newest_ns += [arm.transforms.newest_ns for arm in waiting]
        return all(first.image.stamp_ns <= newest for newest in newest_ns)

    def _matched(self, logged: LoggedImage) -> Matched:
        stamp_ns = logged.image.stamp_ns
        return Matched(logged, self._right.take(stamp_ns), tuple(arm.at(stamp_ns) for arm in self._arms))
