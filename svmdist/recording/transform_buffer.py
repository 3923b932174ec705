"""One transform between two frames as a log streams by, composed along its tree; old samples are forgotten."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np

from svmdist.recording.transform_tree import find_path, frame_name
from svmdist.samples import TransformSample
from svmdist.tracks import MAX_GAP_NS
from svmdist.transforms import Array, interpolate_transforms, inverse

MAX_TRANSFORMS = 20_000
MAX_EDGES = 2_000

Edge = tuple[str, str]


@dataclass
class _Samples:
    """The latest samples of one edge, sorted by stamp."""

    stamps_ns: list[int] = field(default_factory=list)
    transforms: list[Array] = field(default_factory=list)
    is_static: bool = False

    def add(self, stamp_ns: int, T: Array, limit: int) -> None:
        place = bisect_left(self.stamps_ns, stamp_ns)
        if place < len(self.stamps_ns) and self.stamps_ns[place] == stamp_ns:
            self.transforms[place] = T
            return
        if place > 0 and np.array_equal(self.transforms[place - 1], T):
            T = self.transforms[place - 1]  # most bases stand still: one array for all of their stamps
        self.stamps_ns.insert(place, stamp_ns)
        self.transforms.insert(place, T)
        if len(self.stamps_ns) > limit:
            # Half at once, so that forgetting costs nothing per sample.
            del self.stamps_ns[: limit // 2], self.transforms[: limit // 2]

    def at(self, stamp_ns: int) -> Array | None:
        if self.is_static:
            return self.transforms[-1]
        right = bisect_left(self.stamps_ns, stamp_ns)
        if right == len(self.stamps_ns):
            return None
        if self.stamps_ns[right] == stamp_ns:
            return self.transforms[right]
        if right == 0 or self.stamps_ns[right] - self.stamps_ns[right - 1] > MAX_GAP_NS:
            return None
        stamps_ns = np.array(self.stamps_ns[right - 1 : right + 1], np.int64)
        pair = np.array(self.transforms[right - 1 : right + 1])
        return np.asarray(interpolate_transforms(stamps_ns, pair, np.array([stamp_ns], np.int64))[0])


class TransformBuffer:
    """`T_parent_child` at any of the latest instants, where every edge between the two frames has a value."""

    def __init__(self, parent: str, child: str) -> None:
        self._ends = parent, child
        self._edges: dict[Edge, _Samples] = {}
        self._path: list[Edge] | None = None
        self._newest_ns = -1

    @property
    def newest_ns(self) -> int:
        """The stamp up to which more samples would change nothing; without a path, that of any sample."""
        if self._path is None:
            return self._newest_ns
        moving = [samples.stamps_ns[-1] for _, samples in self._along_path() if not samples.is_static]
        return min(moving, default=(1 << 63) - 1)

    def add(self, sample: TransformSample, *, is_static: bool) -> None:
        """Take up a transform; pairs of frames beyond 2,000 are ignored."""
        edge = frame_name(sample.parent), frame_name(sample.child)
        samples = self._edges.get(edge)
        if samples is None:
            if len(self._edges) >= MAX_EDGES:
                return
            samples = self._edges[edge] = _Samples()
            self._path = find_path(self._edges, *self._ends)
        if is_static:
            samples.stamps_ns.clear()
            samples.transforms.clear()
        else:
            self._newest_ns = max(self._newest_ns, sample.stamp_ns)
        samples.is_static = is_static
        samples.add(sample.stamp_ns, sample.T_parent_child, self._limit(edge))

    def at(self, stamp_ns: int) -> Array | None:
        """Interpolate every edge; None where one of them has no value within 0.1 s around the stamp."""
        if self._path is None:
            return None
        T_parent_child = np.eye(4)
        for is_forward, samples in self._along_path():
            T = samples.at(stamp_ns)
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

    def _along_path(self) -> list[tuple[bool, _Samples]]:
        return [
            (True, self._edges[a, b]) if (a, b) in self._edges else (False, self._edges[b, a])
            for a, b in self._path or []
        ]
