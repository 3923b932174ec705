"""Images and the joints at their stamps, in one streaming pass with a bounded look-ahead."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from svmdist.recording.messages.checks import EncodedImage
from svmdist.samples import JointSample
from svmdist.tracks import MAX_GAP_NS

LOOK_AHEAD_NS = 3_000_000_000
"""How long, in log time, an image waits for the joints behind its stamp: clocks may differ by seconds."""
MAX_WAITING_BYTES = 64 << 20
MAX_JOINT_SAMPLES = 20_000


@dataclass(frozen=True, slots=True)
class LoggedImage:
    """An image message, where and when it was logged."""

    log_time_ns: int
    size_bytes: int
    offset: int | None
    image: EncodedImage


class JointBuffer:
    """The latest joint samples, sorted by stamp; the oldest are forgotten."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._samples: list[JointSample] = []

    @property
    def newest_ns(self) -> int:
        """Largest stamp, -1 where there is none."""
        return self._stamps_ns[-1] if self._stamps_ns else -1

    def add(self, sample: JointSample) -> None:
        """Put a sample in its place; one with the same stamp is replaced."""
        place = bisect_left(self._stamps_ns, sample.stamp_ns)
        if place < len(self._stamps_ns) and self._stamps_ns[place] == sample.stamp_ns:
            self._samples[place] = sample
            return
        self._stamps_ns.insert(place, sample.stamp_ns)
        self._samples.insert(place, sample)
        if len(self._samples) > MAX_JOINT_SAMPLES:
            # Half at once, so that forgetting costs nothing per sample.
            del self._stamps_ns[: MAX_JOINT_SAMPLES // 2], self._samples[: MAX_JOINT_SAMPLES // 2]

    def at(self, stamp_ns: int) -> JointSample | None:
        """Interpolate linearly; None outside the samples, and in a gap longer than 0.1 s."""
        right = bisect_left(self._stamps_ns, stamp_ns)
        if right == len(self._stamps_ns):
            return None
        after = self._samples[right]
        if after.stamp_ns == stamp_ns:
            return after
        if right == 0:
            return None
        before = self._samples[right - 1]
        gap_ns = after.stamp_ns - before.stamp_ns
        if gap_ns > MAX_GAP_NS or before.names != after.names:
            return None
        fraction = (stamp_ns - before.stamp_ns) / gap_ns
        positions = before.positions + fraction * (after.positions - before.positions)
        return JointSample(stamp_ns, after.names, positions)


def pair_with_joints(
    messages: Iterable[LoggedImage | JointSample],
) -> Iterator[tuple[LoggedImage, JointSample | None]]:
    """Yield every image in order with the joints at its stamp; messages come in file order."""
    joints = JointBuffer()
    waiting: deque[LoggedImage] = deque()
    waiting_bytes = 0
    for message in messages:
        if isinstance(message, JointSample):
            joints.add(message)
        else:
            waiting.append(message)
            waiting_bytes += message.size_bytes
        while waiting and (waiting_bytes > MAX_WAITING_BYTES or _is_ready(waiting, joints)):
            ready = waiting.popleft()
            waiting_bytes -= ready.size_bytes
            yield ready, joints.at(ready.image.stamp_ns)
    for left in waiting:
        yield left, joints.at(left.image.stamp_ns)


def _is_ready(waiting: deque[LoggedImage], joints: JointBuffer) -> bool:
    first = waiting[0]
    return (
        first.image.stamp_ns <= joints.newest_ns
        or waiting[-1].log_time_ns - first.log_time_ns > LOOK_AHEAD_NS
    )
