"""Images and what belongs to them, in one streaming pass with a bounded look-ahead.

That is the joints and the nominal camera pose of every arm at the image's stamp, and the other image of a stereo
pair.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
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
MAX_SWAPPED_IMAGES = 4
"""As many images wait for one that is stamped before them: two chunks of a log that changed places hold no more."""
MAX_SWAPPED_ITEMS = 1500
"""Nor do they wait for more messages than these: the joints at their stamp would be forgotten meanwhile."""
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

    def __init__(self, tolerance_ns: int = PAIR_TOLERANCE_NS) -> None:
        self._images: deque[LoggedImage] = deque()
        self._tolerance_ns = tolerance_ns
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
        """Hand out the image nearest to a stamp, once; None where none is within the tolerance.

        Frames of a video are handed out in file order: one that was passed over is gone.
        """
        near = [
            logged for logged in self._images if abs(logged.image.stamp_ns - stamp_ns) <= self._tolerance_ns
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
    """Finds what belongs to an image; images wait for right images and for transforms where there are any.

    `on_repeat` hears of images that are left out, for their stamp has come before.
    """

    def __init__(
        self,
        arms: Sequence[ArmBuffer],
        *,
        has_right: bool,
        has_transforms: bool,
        lag_ns: int = 0,
        pair_tolerance_ns: int = PAIR_TOLERANCE_NS,
        on_repeat: Callable[[LoggedImage], None] | None = None,
    ) -> None:
        self._arms = tuple(arms)
        # Joints that are stamped late may be logged late, too.
        self._look_ahead_ns = LOOK_AHEAD_NS + max(0, -lag_ns)
        self._right = RightBuffer(pair_tolerance_ns)
        self._has_right = has_right
        self._has_transforms = has_transforms
        self._waiting: list[LoggedImage] = []
        self._waiting_bytes = 0
        self._last_ns = -1
        self._taken = 0
        self._taken_at: dict[int, int] = {}
        self._on_repeat = on_repeat

    def match(self, items: Iterable[Item]) -> Iterator[Matched]:
        """Yield every image with what is known at its stamp, by stamp and each once; items come in file order."""
        for item in items:
            self._take_up(item)
            while self._waiting and (self._waiting_bytes > MAX_WAITING_BYTES or self._is_ready()):
                yield self._matched(self._next())
        while self._waiting:
            yield self._matched(self._next())

    def _next(self) -> LoggedImage:
        ready = self._waiting.pop(0)
        self._waiting_bytes -= ready.size_bytes
        self._last_ns = ready.image.stamp_ns
        del self._taken_at[self._last_ns]
        return ready

    def _put(self, logged: LoggedImage) -> None:
        """Let an image wait in its place, by stamp; one whose stamp was there before, or has passed, is a repeat."""
        stamp_ns = logged.image.stamp_ns
        place = bisect_left(self._waiting, stamp_ns, key=lambda waiting: waiting.image.stamp_ns)
        is_there = place < len(self._waiting) and self._waiting[place].image.stamp_ns == stamp_ns
        # Frames of a video are decoded as they come: one that would have to wait its turn again is out of it, too.
        is_late = stamp_ns <= self._last_ns or (logged.image.is_ordered and place < len(self._waiting))
        if is_there or is_late:
            if logged.image.is_ordered:
                with suppress(ImageError):
                    logged.image.decode()
            if self._on_repeat is not None:
                self._on_repeat(logged)
            return
        self._taken_at[stamp_ns] = self._taken
        self._waiting.insert(place, logged)
        self._waiting_bytes += logged.size_bytes

    def _take_up(self, item: Item) -> None:
        self._taken += 1
        match item:
            case LoggedImage():
                self._put(item)
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
        newest_ns = max(waiting.log_time_ns for waiting in self._waiting)
        if newest_ns - first.log_time_ns > self._look_ahead_ns:
            return True
        since = self._taken - self._taken_at[first.image.stamp_ns]
        may_be_swapped = len(self._waiting) <= MAX_SWAPPED_IMAGES and since <= MAX_SWAPPED_ITEMS
        if may_be_swapped and not first.image.is_ordered:
            return False
        passed_ns = [self._right.newest_ns] if self._has_right else []
        passed_ns += [arm.joints.newest_ns - JOINT_TRACK_NS for arm in self._arms if arm.has_joints]
        moving = [arm for arm in self._arms if self._has_transforms and arm.fixed is None]
        passed_ns += [arm.transforms.newest_ns for arm in moving]
        return all(first.image.stamp_ns <= newest for newest in passed_ns)

    def _matched(self, logged: LoggedImage) -> Matched:
        stamp_ns = logged.image.stamp_ns
        return Matched(logged, self._right.take(stamp_ns), tuple(arm.at(stamp_ns) for arm in self._arms))
