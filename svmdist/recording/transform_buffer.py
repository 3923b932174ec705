"""One transform between two frames as a log streams by, composed along its tree; old samples are forgotten."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svmdist.recording.latest import Latest
from svmdist.recording.messages.checks import RawTransform
from svmdist.recording.transform_tree import find_path, frame_name
from svmdist.samples import TransformSample
from svmdist.tracks import TransformTrack
from svmdist.transforms import Array, inverse

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
