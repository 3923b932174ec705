"""Images of a log and what belongs to each: joints, the right image, the nominal camera pose."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from svmdist.camera import Camera
from svmdist.recording.images import ImageError
from svmdist.recording.messages.checks import EncodedImage, RawTransform, RawTransforms
from svmdist.recording.source import Loss, LossKind
from svmdist.recording.tf_tree import find_path, frame_name
from svmdist.recording.topics import FixedTransform
from svmdist.samples import (
    Image,
    ImageSample,
    JointSample,
    Observation,
    Rejection,
    RightView,
    Status,
    TransformSample,
)
from svmdist.tracks import JointTrack, TransformTrack
from svmdist.transforms import Array, inverse

Value = TypeVar("Value")


class Latest(Generic[Value]):
    """Samples by stamp; beyond a limit the older half is forgotten."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.values: list[Value] = []

    @property
    def newest_ns(self) -> int:
        """Largest stamp, -1 where there is none."""
        return self.stamps_ns[-1] if self.stamps_ns else -1

    def add(self, stamp_ns: int, value: Value, limit: int) -> None:
        """Put a sample in its place; one with the same stamp is replaced."""
        place = len(self.stamps_ns)
        if place and self.stamps_ns[-1] >= stamp_ns:  # out of order: the rare case
            place = bisect_left(self.stamps_ns, stamp_ns)
            if self.stamps_ns[place] == stamp_ns:
                self.values[place] = value
                return
        self.stamps_ns.insert(place, stamp_ns)
        self.values.insert(place, value)
        if len(self.stamps_ns) > limit:
            # Half at once, so that forgetting costs nothing per sample.
            del self.stamps_ns[: limit // 2], self.values[: limit // 2]

    def clear(self) -> None:
        """Forget all samples."""
        self.stamps_ns.clear()
        self.values.clear()

    def around(self, stamp_ns: int) -> tuple[list[int], list[Value]]:
        """The stamps and values of the samples before and after a stamp: one at the ends and where one meets it."""
        right = bisect_left(self.stamps_ns, stamp_ns)
        is_met = right < len(self.stamps_ns) and self.stamps_ns[right] == stamp_ns
        chosen = slice(right if is_met else max(right - 1, 0), right + 1)
        return self.stamps_ns[chosen], self.values[chosen]

    def between(self, first_ns: int, last_ns: int) -> tuple[list[int], list[Value]]:
        """The stamps and values of all samples from one stamp to another, both included."""
        chosen = slice(bisect_left(self.stamps_ns, first_ns), bisect_right(self.stamps_ns, last_ns))
        return self.stamps_ns[chosen], self.values[chosen]


MAX_TRANSFORMS = 5_000
"""As many as joints are kept, over all edges of the path: 2 MB."""
MAX_EDGES = 2_000

Edge = tuple[str, str]
Stated = RawTransform | TransformSample


@dataclass
class _Edge:
    """The latest samples of one edge."""

    samples: Latest[Stated] = field(default_factory=Latest)
    is_static: bool = False

    def at(self, stamp_ns: int) -> Array | None:
        stamps_ns, near = self.samples.around(stamp_ns)
        if self.is_static:
            stamps_ns, near = [0], self.samples.values[-1:]
        T = np.array([each.T_parent_child for each in near])
        track = TransformTrack("", "", np.array(stamps_ns, np.int64), T, self.is_static)
        sampled = track.at(np.array([stamp_ns], np.int64))
        return sampled.values[0] if sampled.valid[0] else None


class TransformBuffer:
    """`T_parent_child` at any of the latest instants, where every edge between the two frames has a value."""

    def __init__(self, parent: str, child: str) -> None:
        self._ends = parent, child
        self._edges: dict[Edge, _Edge] = {}
        self._path: list[Edge] | None = None
        self._newest_ns = -1

    @property
    def newest_ns(self) -> int:
        """The stamp up to which more samples would change nothing; without a path, that of any sample."""
        if self._path is None:
            return self._newest_ns
        moving = [edge.samples.newest_ns for _, edge in self._along_path() if not edge.is_static]
        return min(moving, default=(1 << 63) - 1)

    def add(self, stated: Stated, *, is_static: bool) -> None:
        """Take up a transform; pairs of frames beyond 2,000 are ignored."""
        name = frame_name(stated.parent), frame_name(stated.child)
        edge = self._edges.get(name)
        if edge is None:
            if len(self._edges) >= MAX_EDGES:
                return
            edge = self._edges[name] = _Edge()
            self._path = find_path(self._edges, *self._ends)
        if is_static:
            edge.samples.clear()
        else:
            self._newest_ns = max(self._newest_ns, stated.stamp_ns)
        edge.is_static = is_static
        edge.samples.add(stated.stamp_ns, stated, self._limit(name))

    def at(self, stamp_ns: int) -> Array | None:
        """Interpolate every edge; None where one of them has no value within 0.1 s around the stamp."""
        if self._path is None:
            return None
        T_parent_child = np.eye(4)
        for is_forward, edge in self._along_path():
            T = edge.at(stamp_ns)
            if T is None:
                return None
            T_parent_child = T_parent_child @ (T if is_forward else inverse(T))
        return T_parent_child

    def _limit(self, edge: Edge) -> int:
        """How many samples an edge may keep: once the path is known, the edges beside it keep two."""
        if self._path is None:
            return max(2, MAX_TRANSFORMS // len(self._edges))
        is_on_path = edge in self._path or edge[::-1] in self._path
        return max(2, MAX_TRANSFORMS // len(self._path)) if is_on_path else 2

    def _along_path(self) -> list[tuple[bool, _Edge]]:
        return [
            (True, self._edges[a, b]) if (a, b) in self._edges else (False, self._edges[b, a])
            for a, b in self._path or []
        ]


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


@dataclass(frozen=True, slots=True)
class Needs:
    """What a method uses of a log beside the left images; what it does not use is not kept nor decoded.

    Joints and transforms are checked in any case: a message of them that is broken is a loss. Images of the
    right camera are read only where they are needed.
    """

    joints: bool = True
    transforms: bool = True
    right: bool = True


EVERYTHING = Needs()
LEFT_IMAGES = Needs(joints=False, transforms=False, right=False)


@dataclass(frozen=True, slots=True)
class RightCamera:
    """The topic of right images, their camera, and where it stands: `T_left_right`, shape (4, 4)."""

    topic: str
    camera: Camera
    T_left_right: Array


@dataclass(frozen=True, slots=True)
class Decoded:
    """An observation of each instrument, or why there is none, and what was lost of the images.

    `place` orders the losses among those of the whole recording.
    """

    found: tuple[Observation, ...] | Rejection
    losses: tuple[Loss, ...] = ()
    place: int = 0


@dataclass(frozen=True, slots=True)
class EncodedObservation:
    """One image with what belongs to it, as it stands in the log; make it with `Recording.encoded_observations`.

    `decode` gives the same whatever the thread and whatever the order, and changes nothing: a caller decodes each
    observation once, and hands the results to `Recording.record_losses`.
    """

    matched: Matched
    camera: Camera
    topic: str
    right: RightCamera | None
    place: int

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.matched.logged.image.stamp_ns

    @property
    def size_bytes(self) -> int:
        """How much the encoded images hold in memory."""
        right = self.matched.right
        return self.matched.logged.size_bytes + (0 if right is None else right.size_bytes)

    def decode(self) -> Decoded:
        """Decode the images; a Rejection stands for a left image that cannot be, or has not its camera's size."""
        losses: list[Loss] = []
        image = decode_image(self.matched.logged, self.topic, losses)
        if isinstance(image, Rejection):
            return Decoded(image, tuple(losses), self.place)
        if _has_other_size(image.image_bgr, self.camera):
            height_px, width_px = image.image_bgr.shape[:2]
            detail = (
                f"{width_px}x{height_px} px; the camera has {self.camera.width_px}x{self.camera.height_px}"
            )
            losses.append(Loss(LossKind.IMAGE, detail, self.matched.logged.offset, self.topic))
            rejection = Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, detail)
            return Decoded(rejection, tuple(losses), self.place)
        view = self._right_view(losses)
        found = tuple(
            Observation(
                image.stamp_ns,
                image.image_bgr,
                self.camera,
                arm.joints,
                view,
                arm.T_camera_base,
                arm.joint_track,
            )
            for arm in self.matched.arms
        )
        return Decoded(found, tuple(losses), self.place)

    def _right_view(self, losses: list[Loss]) -> RightView | None:
        if self.right is None or self.matched.right is None:
            return None
        image = decode_image(self.matched.right, self.right.topic, losses)
        if isinstance(image, Rejection) or _has_other_size(image.image_bgr, self.right.camera):
            return None
        delay_s = (image.stamp_ns - self.stamp_ns) * 1e-9
        return RightView(image.image_bgr, self.right.camera, self.right.T_left_right, delay_s)


def decode_image(logged: LoggedImage, topic: str, losses: list[Loss]) -> ImageSample | Rejection:
    """Decode an image; one that cannot be is a rejection, and joins the losses."""
    image = logged.image
    try:
        return ImageSample(image.stamp_ns, image.frame_id, image.decode())
    except ImageError as problem:
        losses.append(Loss(LossKind.IMAGE, str(problem), logged.offset, topic))
        return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))


def decode_in_order(image: EncodedImage) -> EncodedImage:
    """Decode a frame of a video at once, so that any thread may ask for its pixels; other images stay as they are."""
    if not image.is_ordered:
        return image
    try:
        pixels: Image | ImageError = image.decode()
    except ImageError as problem:
        pixels = problem

    def give() -> Image:
        if isinstance(pixels, ImageError):
            raise ImageError(str(pixels))
        return pixels

    return EncodedImage(image.stamp_ns, image.frame_id, give)


def _has_other_size(image_bgr: Image, camera: Camera) -> bool:
    return image_bgr.shape[:2] != (camera.height_px, camera.width_px)
