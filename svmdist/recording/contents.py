"""Everything in a log but its images, in arrays over time: joints, poses, distances, and transforms by frame."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from svmdist.errors import RecordingError, did_you_mean
from svmdist.profile import Limits
from svmdist.profile.robot import Robot
from svmdist.recording import messages
from svmdist.recording.observations import CameraTrack, MissingPartners
from svmdist.recording.source import LossKind, RawMessage, Source, sanitize, sanitize_list
from svmdist.samples import CameraSample, DistanceSample, JointSample
from svmdist.tracks import LagEstimate, Sampled, TransformTrack, apart_ns, sort_stamps
from svmdist.transforms import Array, Stamps, inverse

Joints = tuple[str, ...]  # names of the joints of a message
MAX_JOINT_SETS = 100  # how many such a topic may have


class Rows:
    """Stamped rows of numbers in the order of the file."""

    def __init__(self) -> None:
        self.stamps_ns, self.values = array("q"), array("d")

    def add(self, stamp_ns: int, values: Iterable[float]) -> None:
        """Append a row."""
        self.stamps_ns.append(stamp_ns)
        self.values.extend(values)

    def arrays(self) -> tuple[Stamps, Array]:
        """Stamps, shape (n,), and rows, shape (n, k)."""
        count = len(self.stamps_ns)
        rows = np.array(self.values, np.float64).reshape(count, -1 if count else 0)
        return np.array(self.stamps_ns, np.int64), rows


class Contents(defaultdict[str, defaultdict[Hashable, Rows]]):
    """What messages hold: by topic, and by names of joints, frame of poses, or edge of transforms."""

    def __init__(self) -> None:
        super().__init__(lambda: defaultdict(Rows))


def in_order(stamps_ns: Stamps, rows: Array, lag: LagEstimate | None = None) -> tuple[Stamps, Array]:
    """Distinct rising stamps, later by a lag, and their rows; of equal stamps the first row counts, as of images."""
    stamps_ns = stamps_ns + np.minimum(lag.lag_ns if lag else 0, np.iinfo(np.int64).max - stamps_ns)
    order = sort_stamps(stamps_ns)
    return stamps_ns[order], rows[order]


class TransformTree:
    """Transforms between any two frames of a log, of topics that are static or not: edges over time, composed."""

    def __init__(self, contents: Contents, topics: Mapping[str, bool], lag: LagEstimate | None = None) -> None:
        self._edges: dict[Any, tuple[Rows, bool]] = {}  # by parent and child
        for topic, is_static in topics.items():
            self._edges |= {edge: (rows, is_static) for edge, rows in contents.get(topic, {}).items()}
        self._lag, self._tracks = lag, dict[tuple[str, str], TransformTrack]()

    def links(self, parent: str, child: str) -> bool:
        """Whether a path links two frames."""
        return parent != child and child in self._reach(parent)

    def at(self, parent: str, child: str, stamps_ns: Stamps) -> Sampled:
        """`T_parent_child` at stamps, shape (n, 4, 4), edges interpolated; RecordingError without a path."""
        T = np.repeat(np.eye(4)[None], len(stamps_ns), axis=0)
        valid = np.ones(len(stamps_ns), np.bool_)
        for track in self._along(parent, child):
            sampled = track.at(stamps_ns)
            T = T @ sampled.values
            valid &= sampled.valid
        return Sampled(T, valid)

    def apart_ns(self, parent: str, child: str, at_ns: Stamps) -> Stamps:
        """How far the nearest transforms are from stamps, shape (n,), on the edge that has them farthest off; or 0."""
        moving = [track.stamps_ns for track in self._along(parent, child) if not track.is_static]
        return np.asarray(np.max([np.zeros_like(at_ns), *(apart_ns(one, at_ns) for one in moving)], 0))

    def track(self, parent: str, child: str) -> TransformTrack:
        """`T_parent_child` at all moving edges' stamps, where each has a value; RecordingError without a path."""
        tracks = self._along(parent, child)
        if len(tracks) == 1:
            return tracks[0]
        moving = [track.stamps_ns for track in tracks if not track.is_static]
        stamps_ns = np.unique(np.concatenate(moving)) if moving else np.zeros(1, np.int64)
        found = self.at(parent, child, stamps_ns)
        return TransformTrack(parent, child, stamps_ns[found.valid], found.values[found.valid], is_static=not moving)

    def _track(self, parent: str, child: str) -> TransformTrack:
        edge = parent, child
        if edge not in self._tracks:
            rows, is_static = self._edges[edge if edge in self._edges else (child, parent)]
            stamps_ns, values = in_order(*rows.arrays(), self._lag)
            if is_static:
                stamps_ns, values = stamps_ns[:1], np.array([rows.values[-7:]])
            T = messages.matrices(values)
            self._tracks[edge] = TransformTrack(*edge, stamps_ns, T if edge in self._edges else inverse(T), is_static)
        return self._tracks[edge]

    def _along(self, parent: str, child: str) -> list[TransformTrack]:
        """The shortest chain of edges, in either direction; RecordingError says what is missing."""
        frames = {name for edge in self._edges for name in edge}
        for name in (parent, child):
            if name not in frames:
                raise RecordingError(f"no frame {name} in the transforms: {did_you_mean(name, map(sanitize, frames))}")
        if parent == child:
            raise RecordingError(f"a transform from {parent} to itself was asked for; two frames are expected")
        reached = self._reach(parent)
        if child not in reached:
            here, there = (sanitize_list(sorted(self._reach(frame))) for frame in (parent, child))
            sides = f"on one side are {here}; on the other {there}"
            raise RecordingError(f"no transform links {parent} and {child}: {sides}")
        tracks = []
        while child != parent:
            tracks.append(self._track(reached[child], child))
            child = reached[child]
        return tracks[::-1]

    def _reach(self, start: str) -> dict[str, str]:
        """Every frame that edges link to `start`, each with the frame it is reached from, breadth first."""
        neighbours: defaultdict[str, list[str]] = defaultdict(list)
        for parent, child in self._edges:
            neighbours[parent].append(child)
            neighbours[child].append(parent)
        reached, queue = {start: start}, [start]
        for frame in queue:  # which grows
            new = [one for one in dict.fromkeys(neighbours[frame]) if one not in reached]
            reached |= dict.fromkeys(new, frame)
            queue += new
        return reached


def best_joints(found: Iterable[Joints], robot: Robot | None) -> Joints:
    """Of the joints that a topic's messages have, those that lack fewest of a robot's, then the most."""
    return min(found, key=lambda names: (len(robot.missing_joints(names)) if robot else 0, -len(names)))


def joint_rows(by_names: Mapping[Joints, Rows], robot: Robot | None) -> tuple[Joints, Stamps, Array, list[str]]:
    """Names, stamps and positions of the joints of a topic, and what messages that do not count lack, in words.

    Several nodes may publish on it, and in any order. Those messages count that have the joints of the robot which the
    best ones have; without a robot, all joints.
    """
    if len(by_names) == 1:
        ((names, only),) = by_names.items()
        stamps_ns, rows = only.arrays()
        if (np.diff(stamps_ns) >= 0).all():  # as nearly always: nothing is copied
            return names, stamps_ns, rows, []
    best, chain = best_joints(by_names, robot), robot.joint_names if robot else frozenset()
    needed = [name for name in best if name in chain] or best
    usable = [names for names in by_names if set(needed) <= set(names)]
    common = tuple(name for name in best if all(name in names for names in usable))
    found = [by_names[names].arrays() for names in usable]
    stamps_ns = np.concatenate([each for each, _ in found])
    order = np.argsort(stamps_ns, kind="stable")
    columns = [[*map(names.index, common)] for names in usable]
    rows = np.concatenate([each[:, places] for (_, each), places in zip(found, columns, strict=True)])
    lacks = [
        f"{len(by_names[names].stamps_ns)} joint states have no usable position of"
        f" {sanitize_list(name for name in needed if name not in names)}"
        for names in by_names
        if names not in usable
    ]
    return common, stamps_ns[order], rows[order], lacks


@dataclass(eq=False)
class LogFile:
    """An open file, and what the first whole pass read of it beside images; all views of a recording share it."""

    source: Source
    limits: Limits
    topics: frozenset[str]
    camera_topics: frozenset[str]  # those of `topics` with calibrations, which every pass over images reads
    cameras: defaultdict[str, CameraTrack] = field(default_factory=lambda: defaultdict(CameraTrack))  # known so far
    missing: MissingPartners = field(default_factory=lambda: MissingPartners(0.0))  # of the last replay's images
    _contents: Contents | None = None

    @property
    def contents(self) -> Contents:
        """What the messages of `topics` hold."""
        if self._contents is None:
            deque(self.images(frozenset()), maxlen=0)  # reads all else to the end
        assert self._contents is not None
        return self._contents

    def images(self, image_topics: Collection[str], *, rest: bool = True) -> Iterator[messages.EncodedImage]:
        """Yield the images of some topics in file order, not decoded; with `rest` reads all else that is not read."""
        contents, decoder, others = Contents(), messages.Decoder(self.limits), frozenset[str]()
        if self._contents is None:
            others = self.topics if rest else self.camera_topics
        for raw in self.source.messages(frozenset(image_topics) | others):
            if raw.topic in image_topics:
                yield decoder.image(raw)
            else:
                self.collect(contents, decoder, raw)
        if rest and self._contents is None:
            self._contents = contents

    def camera_track(self, topic: str) -> CameraTrack:
        """What is known of a topic's calibrations so far: the first usable one at least, where there is one."""
        track = self.cameras[topic]
        if not track.runs and self._contents is None:
            contents, decoder = Contents(), messages.Decoder(self.limits)
            for raw in self.source.messages({topic}):
                self.collect(contents, decoder, raw)
                if track.runs:
                    break
        return track

    def collect(self, contents: Contents, decoder: messages.Decoder, raw: RawMessage) -> messages.Message | None:
        """Take up what a message holds, and give it; None for one that cannot be used, which is a loss."""
        rows = contents[raw.topic]
        try:
            match message := decoder.decode(raw):
                case CameraSample(stamp_ns, camera):
                    self.cameras[raw.topic].add(stamp_ns, camera)
                case JointSample(stamp_ns, names, positions):
                    if len(rows) >= MAX_JOINT_SETS and names not in rows:
                        raise messages.DecodeError(f"its joints are new, as {MAX_JOINT_SETS} times before")
                    rows[names].add(stamp_ns, positions.tolist())
                case DistanceSample(stamp_ns, planar_m, spatial_m, clearance_m):
                    rows[None].add(stamp_ns, (planar_m, spatial_m, clearance_m))
                case messages.RawTransform(stamp_ns, parent, values=values):
                    rows[parent].add(stamp_ns, values)
                case messages.RawTransforms(transforms=transforms):
                    for one in transforms:
                        rows[one.parent, one.child].add(one.stamp_ns, one.values)
        except messages.DecodeError as problem:
            self.source.health.lose(LossKind.MESSAGE, str(problem), raw.offset, raw.topic)
            return None
        return message
