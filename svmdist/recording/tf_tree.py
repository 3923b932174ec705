"""Transforms between any two frames of a log: edges over time, composed along the path that links them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from svmdist.errors import RecordingError, did_you_mean
from svmdist.recording.source import sanitize, sanitize_list
from svmdist.samples import TransformSample
from svmdist.tracks import MAX_GAP_NS, TransformTrack, sort_stamps
from svmdist.transforms import Array, inverse

MAX_EDGES = 10_000


@dataclass
class _Edge:
    stamps_ns: list[int] = field(default_factory=list)
    transforms: list[Array] = field(default_factory=list)
    is_static: bool = False


class TransformTree:
    """All transforms of a log, by pair of frames."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], _Edge] = {}

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames, sorted."""
        return tuple(sorted({name for pair in self._edges for name in pair}))

    def add(self, sample: TransformSample, *, is_static: bool) -> None:
        """Take up a transform; RecordingError when there are more pairs of frames than a robot can have."""
        edge = self._edges.setdefault((frame_name(sample.parent), frame_name(sample.child)), _Edge())
        if len(self._edges) > MAX_EDGES:
            raise RecordingError(f"more than {MAX_EDGES} pairs of frames in the transforms")
        edge.is_static = is_static
        if is_static:
            edge.stamps_ns.clear()
            edge.transforms.clear()
        edge.stamps_ns.append(sample.stamp_ns)
        edge.transforms.append(sample.T_parent_child)

    def track(self, parent: str, child: str, max_gap_ns: int = MAX_GAP_NS) -> TransformTrack:
        """Compose `T_parent_child` over time along the path between two frames.

        The stamps are those of all edges on the path that move; a stamp is left out where one of the
        edges has no value. RecordingError names both sides where no path links them.
        """
        hops = self._path(parent, child)
        tracks = [self._edge_track(*hop) for hop in hops]
        if len(tracks) == 1:
            return tracks[0]
        moving = [track for track in tracks if not track.is_static]
        if not moving:
            T = np.eye(4)
            for track in tracks:
                T = T @ track.T_parent_child[0]
            return TransformTrack(parent, child, np.zeros(1, np.int64), T[None], is_static=True)
        stamps_ns = np.unique(np.concatenate([track.stamps_ns for track in moving]))
        T_parent_child = np.repeat(np.eye(4)[None], len(stamps_ns), axis=0)
        valid = np.ones(len(stamps_ns), np.bool_)
        for track in tracks:
            sampled = track.at(stamps_ns, max_gap_ns)
            T_parent_child = T_parent_child @ sampled.values
            valid &= sampled.valid
        return TransformTrack(parent, child, stamps_ns[valid], T_parent_child[valid])

    def _edge_track(self, parent: str, child: str) -> TransformTrack:
        is_forward = (parent, child) in self._edges
        edge = self._edges[(parent, child) if is_forward else (child, parent)]
        stamps_ns = np.array(edge.stamps_ns, np.int64)
        order = sort_stamps(stamps_ns)
        T = np.array(edge.transforms)[order]
        return TransformTrack(
            parent, child, stamps_ns[order], T if is_forward else inverse(T), edge.is_static
        )

    def _path(self, parent: str, child: str) -> list[tuple[str, str]]:
        """Find the shortest chain of edges; RecordingError tells what is missing."""
        for frame in (parent, child):
            if frame not in self.frames:
                raise RecordingError(
                    f"no frame {frame} in the transforms: {did_you_mean(frame, map(sanitize, self.frames))}"
                )
        if parent == child:
            raise RecordingError(
                f"a transform from {parent} to itself was asked for; two frames are expected"
            )
        path = find_path(self._edges, parent, child)
        if path is None:
            here, there = (sanitize_list(sorted(_reach(self._edges, frame))) for frame in (parent, child))
            raise RecordingError(
                f"no transform links {parent} and {child}: on one side are {here}; on the other {there}"
            )
        return path


def frame_name(name: str) -> str:
    """A frame's name as tf2 has it: tf of old wrote /base."""
    return name.removeprefix("/")


def find_path(edges: Iterable[tuple[str, str]], parent: str, child: str) -> list[tuple[str, str]] | None:
    """Find the shortest chain of edges, in either direction, by breadth-first search; None without one."""
    reached = _reach(edges, parent)
    if child not in reached:
        return None
    path = []
    frame = child
    while frame != parent:
        path.append((reached[frame], frame))
        frame = reached[frame]
    return path[::-1]


def _reach(edges: Iterable[tuple[str, str]], start: str) -> dict[str, str]:
    """Find every frame that edges link to `start`, each with the frame it is reached from."""
    neighbours: dict[str, list[str]] = {}
    for parent, child in edges:
        neighbours.setdefault(parent, []).append(child)
        neighbours.setdefault(child, []).append(parent)
    reached = {start: start}
    queue = deque([start])
    while queue:
        frame = queue.popleft()
        for neighbour in neighbours.get(frame, []):
            if neighbour not in reached:
                reached[neighbour] = frame
                queue.append(neighbour)
    return reached
