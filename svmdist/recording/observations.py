"""Observations whose images are still encoded: given their cameras and paired in one thread, decoded in any."""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera, stereo_transform
from svmdist.errors import UsageError
from svmdist.perturbations import Perturbations
from svmdist.perturbations.apply import nominal_camera
from svmdist.recording.images import ImageError
from svmdist.recording.messages import EncodedImage
from svmdist.recording.source import Health, Loss, LossKind
from svmdist.samples import Image, JointSample, Observation, Rejection, RightView, Status
from svmdist.tracks import MAX_GAP_NS, JointTrack, nearest_in_words
from svmdist.transforms import Array

ROUNDING = 1e-6  # relative, and in px: calibrations that differ by no more are one
SMALL_PX = 1.0  # K that differs by less is within what any calibration is uncertain by: either may hold
MAX_RUNS = 10_000  # what a camera may change in a log: others are not kept
LOOK_AHEAD_NS = 3_000_000_000  # how long, in log time, an image waits for the right image at its stamp
MAX_WAITING_BYTES = 64 << 20
MAX_SWAPPED_IMAGES = 4  # wait for one stamped before them: two chunks of a log that changed places hold no more
STAMP = attrgetter("stamp_ns")


class Run(NamedTuple):
    """A calibration, and the stamps of the first and the last message in a row that say so."""

    camera: Camera
    first_ns: int
    last_ns: int


class Cameras(NamedTuple):
    """The cameras of an image and of the right one, if any; `ambiguity` says why it is not known which hold."""

    left: Camera
    right: tuple[Camera, Array] | None = None  # with `T_left_right`, shape (4, 4)
    ambiguity: str = ""


class CameraChange(NamedTuple):
    """Two calibrations that follow each other on a topic; `start_ns` is the stamp of the topic's first message."""

    topic: str
    before: Run
    after: Run
    start_ns: int

    def __str__(self) -> str:
        from_s, to_s = ((ns - self.start_ns) * 1e-9 for ns in (self.before.last_ns, self.after.first_ns))
        what = changed(self.before.camera, self.after.camera)
        return f"{what} between {from_s:.2f} and {to_s:.2f} s ({self.topic})"


class CameraTrack:
    """The calibrations of one topic, in runs of equal ones; a message that comes behind later ones does not count."""

    def __init__(self) -> None:
        self.runs: list[Run] = []

    def add(self, stamp_ns: int, camera: Camera) -> None:
        """Take up a message; the same one may come again, in another pass over the log."""
        last = self.runs[-1] if self.runs else Run(camera, -1, -1)
        if stamp_ns > last.last_ns and self.runs and _is_same(last.camera, camera):
            self.runs[-1] = last._replace(last_ns=stamp_ns)
        elif stamp_ns > last.last_ns and len(self.runs) < MAX_RUNS:
            self.runs.append(Run(camera, stamp_ns, stamp_ns))

    def at(self, stamp_ns: int) -> tuple[int, str]:
        """Which run holds at a stamp, the first before all and the last behind; and the ambiguity between two."""
        place = max(0, bisect_right(self.runs, stamp_ns, key=lambda run: run.first_ns) - 1)
        run = self.runs[place]
        if stamp_ns <= run.last_ns or place + 1 == len(self.runs):
            return place, ""
        following = self.runs[place + 1].camera
        is_small = run.camera.same_optics(following, SMALL_PX)
        return place, "" if is_small else f"the camera changes about here: {changed(run.camera, following)}"

    def changes(self, topic: str) -> list[CameraChange]:
        """What changes from each run to the next."""
        return [CameraChange(topic, *pair, self.runs[0].first_ns) for pair in pairwise(self.runs)]


def cameras_at(left: CameraTrack, right: CameraTrack | None, perturbations: Perturbations) -> Callable[[int], Cameras]:
    """The cameras that hold at a stamp, so far as their tracks are known, perturbed."""

    @cache
    def held(left_run: int, right_run: int) -> Cameras:
        camera = nominal_camera(left.runs[left_run].camera, perturbations)
        if right is None:
            return Cameras(camera)
        other = nominal_camera(right.runs[right_run].camera, perturbations, right=True)
        T_left_right = stereo_transform(camera, other)
        return Cameras(camera, None if T_left_right is None else (other, T_left_right))

    def at(stamp_ns: int) -> Cameras:
        left_run, ambiguity = left.at(stamp_ns)
        right_run, of_right = (0, "") if right is None else right.at(stamp_ns)
        return held(left_run, right_run)._replace(ambiguity=ambiguity or of_right)

    return at


def changed(before: Camera, after: Camera) -> str:
    """What differs between two calibrations, in words."""
    both = before, after
    baselines_m = (0.0 if one.P is None else abs(one.P[0, 3]) / one.K[0, 0] for one in both)
    named = {
        "size": (f"{one.width_px}x{one.height_px} px" for one in both),
        "focal length": (f"{one.K[0, 0]:.1f} px" for one in both),
        "principal point": (f"{one.K[0, 2]:.1f}, {one.K[1, 2]:.1f} px" for one in both),
        "baseline": (f"{baseline_m * 1e3:.2f} mm" for baseline_m in baselines_m),
    }
    said = ((name, *values) for name, values in named.items())
    found = [f"{name} {one} -> {other}" for name, one, other in said if one != other]
    return ", ".join(found) or "distortion or rectification"


def _is_same(one: Camera, other: Camera) -> bool:
    for a, b in ((one.R_rectified_camera, other.R_rectified_camera), (one.P, other.P)):
        if a is not b and (a is None or b is None or not np.allclose(a, b, ROUNDING, ROUNDING)):
            return False
    return one.same_optics(other, ROUNDING * max(one.K[0, 0], 1.0))


class Pair(NamedTuple):
    """A left image with its right one; else how far the nearest right one is, in s, where one is wanted."""

    left: EncodedImage
    right: EncodedImage | None = None
    right_apart_s: float | None = None


class Pairs:
    """Images in the order of their stamps, each with the nearest right one in tolerance; late ones are losses."""

    def __init__(self, right_topic: str | None, tolerance_s: float, health: Health) -> None:
        self._right_topic, self._health = right_topic, health
        self._tolerance_ns = round(tolerance_s * 1e9)
        self._left: list[EncodedImage] = []
        self._right: list[EncodedImage] = []
        self._newest_right_ns = self._last_ns = -1
        self._gone_right_ns = -math.inf

    def of(self, images: Iterable[EncodedImage]) -> Iterator[Pair]:
        """Yield the left images by their stamps; images come in file order."""
        for image in images:
            if image.topic == self._right_topic:
                insort(self._right, image, key=STAMP)
                self._newest_right_ns = max(self._newest_right_ns, image.stamp_ns)
                while len(self._right) > 1 and _size(self._right) > MAX_WAITING_BYTES:
                    del self._right[0]
            elif image.stamp_ns <= self._last_ns or image.stamp_ns in map(STAMP, self._left):
                late = "repeats a stamp, or comes too far behind later ones; it is left out"
                detail = f"an image of {image.stamp_ns} ns {late}"
                self._health.lose(LossKind.MESSAGE, detail, image.offset, image.topic)
            else:
                insort(self._left, image, key=STAMP)
            while self._left and self._is_ready():
                yield self._next()
        while self._left:
            yield self._next()

    def _is_ready(self) -> bool:
        newest_ns = max(image.log_time_ns for image in self._left)
        if newest_ns - self._left[0].log_time_ns > LOOK_AHEAD_NS or _size(self._left) > MAX_WAITING_BYTES:
            return True
        is_paired = self._right_topic is None or self._newest_right_ns >= self._left[0].stamp_ns
        return is_paired and len(self._left) > MAX_SWAPPED_IMAGES

    def _next(self) -> Pair:
        left = self._left.pop(0)
        self._last_ns = left.stamp_ns
        if self._right_topic is None:
            return Pair(left)
        while self._right and self._right[0].stamp_ns < left.stamp_ns - self._tolerance_ns:
            self._gone_right_ns = self._right.pop(0).stamp_ns
        nearest = min(self._right, key=lambda image: abs(image.stamp_ns - left.stamp_ns), default=None)
        nearest_ns = math.inf if nearest is None else nearest.stamp_ns
        if nearest is None or nearest_ns > left.stamp_ns + self._tolerance_ns:
            apart_ns = min(nearest_ns - left.stamp_ns, left.stamp_ns - self._gone_right_ns)
            return Pair(left, None, apart_ns * 1e-9)
        self._right.remove(nearest)
        self._gone_right_ns = nearest.stamp_ns
        return Pair(left, nearest)


def _size(images: list[EncodedImage]) -> int:
    return sum(image.size_bytes for image in images)


@dataclass
class MissingPartners:
    """What the images of one replay lack near them, and how far the nearest is: `inf` where the log has none."""

    pair_tolerance_s: float
    image_count: int = 0
    apart_s: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    repeat_count: int = 0  # of a log that has no joints to tell a still scene from a video that froze

    def add(self, **apart_s: float | None) -> None:
        """Count an image, with how far the nearest right one, joints or transforms are, where these are missing."""
        self.image_count += 1
        for what, far_s in apart_s.items():
            self.apart_s[what] += [] if far_s is None else [far_s]

    def describe(self) -> list[str]:
        """A line each for right images, joint states and transforms that are missing, and one for repeated images."""
        of_left = f"within {self.pair_tolerance_s * 1e3:g} ms of the left"
        of_image = f"on both sides of the image, {MAX_GAP_NS * 1e-6:g} ms apart at most"
        often = f"in {{}} of {self.image_count} frames no {{}}"
        repeats = "images that repeat the one before them to the last byte"
        still = [f"{repeats}: {self.repeat_count}; the video stands still there"] * (self.repeat_count > 0)
        return still + [
            f"{f'{what} never' if len(far_s) == self.image_count else often.format(len(far_s), what)} {near}"
            f" ({nearest_in_words(float(np.median(far_s)))}){hence}"
            for key, what, near, hence in (
                ("right", "right image", of_left, ": measured with one camera"),
                ("joints", "joint states", of_image, ""),
                ("base", "transform from the camera to the base", of_image, ""),
            )
            if (far_s := self.apart_s[key])
        ]


JOINT_TRACK_NS = 200_000_000  # joints so near an image go with it: clocks may differ as much for a method to find it
OUT_OF_ORDER_S = 1.0  # by which images may stand out of order in a file: reading goes on so long after a window's end


@dataclass(frozen=True, slots=True)
class Window:
    """Every `every`-th image from `start_s` to `end_s` after the first one, both included; UsageError if impossible."""

    start_s: float = 0.0
    end_s: float = math.inf
    every: int = 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.start_s < math.inf:
            raise UsageError(f"--start {self.start_s:g}: expected seconds after the first image, as in 2.5")
        if not self.end_s >= self.start_s:
            raise UsageError(f"--end {self.end_s:g}: is before --start {self.start_s:g}")
        if not (self.every >= 1 and self.every % 1 == 0):
            raise UsageError(f"--every {self.every}: expected 1 or more")

    def holds(self, at_ns: Any) -> Any:
        """Whether times since the first image, one or an array, lie between start and end."""
        # To the nearest nanosecond: an image at exactly 0.1 s is inside of a window that begins at 0.1 s.
        return (at_ns >= self.start_s * 1e9 - 0.5) & (at_ns <= self.end_s * 1e9 + 0.5)

    def of(self, pairs: Iterable[Pair]) -> Iterator[tuple[int, int, Pair]]:
        """The images inside, each behind its number among all and its time since the first one, in ns."""
        first_ns, count = 0, 0
        for number, pair in enumerate(pairs):
            first_ns = first_ns if number else pair.left.stamp_ns
            at_ns = pair.left.stamp_ns - first_ns
            if at_ns > (self.end_s + OUT_OF_ORDER_S) * 1e9:
                return
            if self.holds(at_ns):
                if count % self.every == 0:
                    yield number, at_ns, pair
                count += 1

    def places(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which of rising stamps, shape (n,), are inside, counted from the first one."""
        return np.flatnonzero(self.holds(stamps_ns - stamps_ns[:1]))[:: self.every]


ALL_IMAGES = Window()


def decode_image(image: EncodedImage, losses: list[Loss], camera: Camera | None = None) -> Image | Rejection:
    """The pixels; of an image that cannot be decoded, or has not the camera's size, a rejection, and a loss more."""
    try:
        pixels = image.decode()
        height_px, width_px = pixels.shape[:2]
        if camera is not None and (width_px, height_px) != (camera.width_px, camera.height_px):
            raise ImageError(f"{width_px}x{height_px} px; the camera has {camera.width_px}x{camera.height_px}")
    except ImageError as problem:
        losses.append(Loss(LossKind.IMAGE, str(problem), image.offset, image.topic))
        return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))
    return pixels


class ArmState(NamedTuple):
    """What one arm reported at an image's stamp: joints, those around it, and `T_camera_base`, shape (4, 4)."""

    joints: JointSample | None
    joint_track: JointTrack | None
    T_camera_base: Array | None
    joints_apart_s: float | None  # how far the nearest joints are where the log has some and none is near the image
    base_apart_s: float | None  # the same of the transforms


@dataclass(frozen=True, slots=True)
class Decoded:
    """An observation of each instrument, or why there is none; `place` orders the losses among all others."""

    found: tuple[Observation, ...] | Rejection
    losses: tuple[Loss, ...]
    place: int

    @property
    def seen(self) -> tuple[Observation, ...] | None:
        """The observation of each instrument; None where it cannot be decoded."""
        return None if isinstance(self.found, Rejection) else self.found


@dataclass(frozen=True)
class EncodedObservation:
    """One image with what belongs to it, as it stands in the log; `Recording.encoded_observations` makes them."""

    left: EncodedImage
    right: EncodedImage | None
    arms: tuple[ArmState, ...]
    cameras: Cameras
    place: int
    number: int  # among the log's images
    at_ns: int  # since the log's first image
    repeats: str = ""  # what is said of an image that is the same to the last byte though the robot has moved

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.left.stamp_ns

    @cached_property
    def decoded(self) -> Decoded:
        """The same, kept for repeated use."""
        return self.decode()

    def decode(self) -> Decoded:
        """Decode the images, in any thread, for `Recording.record_losses`; a Rejection without left image or camera."""
        losses: list[Loss] = []
        camera, of_right, ambiguity = self.cameras
        if ambiguity:
            return Decoded(Rejection(self.stamp_ns, Status.INCONSISTENT, ambiguity), (), self.place)
        image = decode_image(self.left, losses, camera)
        if isinstance(image, Rejection):
            return Decoded(image, tuple(losses), self.place)
        right = None
        if self.right is not None and of_right is not None:
            right_image = decode_image(self.right, losses, of_right[0])
            if not isinstance(right_image, Rejection):
                right = RightView(right_image, *of_right, (self.right.stamp_ns - self.stamp_ns) * 1e-9)
        found = tuple(
            Observation(self.stamp_ns, image, camera, arm.joints, right, arm.T_camera_base, arm.joint_track)
            for arm in self.arms
        )
        return Decoded(found, tuple(losses), self.place)


def joints_at(track: JointTrack | None, stamp_ns: int) -> tuple[JointSample | None, JointTrack | None]:
    """Joints interpolated to a stamp, and those around it; None where there are none within 0.1 s."""
    if track is None or not (sampled := track.at(np.array([stamp_ns], np.int64))).valid[0]:
        return None, None
    first, last = np.searchsorted(track.stamps_ns, [stamp_ns - JOINT_TRACK_NS, stamp_ns + JOINT_TRACK_NS + 1])
    around = JointTrack(track.stamps_ns[first:last], track.names, track.positions[first:last])
    return JointSample(stamp_ns, track.names, sampled.values[0]), around
