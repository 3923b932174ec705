"""Given estimates: what others measured, from a file or a topic of the log, as a method that is scored like ours."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.distances import with_tool
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.tissue.tracking import surface_by_stereo
from svmdist.geometry.distance import separation
from svmdist.importing.estimates import DISTANCES, TEXTS, Rows, read_estimates
from svmdist.importing.tables import require_common_time
from svmdist.recording.log import Recording
from svmdist.recording.observations import ALL_IMAGES
from svmdist.results import Distance, Distances, FrameResult, ToolEstimate, ToolPose, as_vector
from svmdist.samples import Status
from svmdist.tracks import MAX_GAP_NS, Sampled, sort_stamps
from svmdist.transforms import Stamps, frame_name
from svmdist.workflows.request import LOG
from svmdist.workflows.scoring.references import Reference, TruthRules, in_camera, tool_track

TOPIC = "topic:"


@dataclass(frozen=True)
class Given:
    """Estimates of others: a table, or poses of a topic or of a reference; `for_log` places them at a log's images.

    Poses without distances are measured to the tissue that each image shows, on the profile's plane or, `on_surface`,
    where both views see it. `digest` tells the contents of files apart; `rows` are those of each instrument.
    """

    name: str
    table: Rows | None = field(default=None, repr=False)
    topic: str = ""
    rules: TruthRules | None = None
    on_surface: bool = False
    digest: str = ""
    rows: Mapping[str, Rows] | None = field(default=None, repr=False)
    sees_tissue: bool = False
    is_given = True

    @property
    def needs(self) -> Needs:
        """What it takes of a log: the tissue where it has no distances."""
        if not self.sees_tissue:
            return Needs(robot=False)
        return Needs(("tissue", "stereo_surface") if self.on_surface else ("tissue",), right_view=self.on_surface)

    def for_log(self, log: Recording) -> Given:
        """The estimates at the images of a log, each at the nearest one; RecordingError where none is near any."""
        if self.rows is not None:
            return self
        has_distances = self.table is not None and bool(self.table.keys() & set(DISTANCES))
        sees_tissue = not has_distances and log.origin.profile.tissue is not None
        return replace(self, rows=self._rows(log), sees_tissue=sees_tissue)

    def _rows(self, log: Recording) -> dict[str, Rows]:
        images = replace(log, window=ALL_IMAGES).encoded_observations(robot=False, right=False)
        images_ns = np.unique(np.array([image.stamp_ns for image in images], np.int64))
        views = {name: log.for_instrument(name) for name in log.instruments if len(images_ns)}
        if self.table is not None and views:
            return {name: self._near(of, views[name], images_ns) for name, of in self._selected(views).items()}
        if self.topic and views:  # of the instrument whose poses these are, else of the first one
            owners = [name for name, view in views.items() if view.topic_of("pose") == self.topic]
            views = {name: views[name] for name in (owners or log.instruments)[:1]}
        return {name: self._poses(view, images_ns) for name, view in views.items()}

    def _poses(self, view: Recording, images_ns: Stamps) -> Rows:
        """Poses of a topic or a reference, interpolated to the images."""
        if self.rules is not None:
            at = tool_track(view, Reference.PLANE, self.rules)
        else:
            track = view.origin._replace(topics=view.origin.topics | {"pose": self.topic}).open().pose_track()
            require_common_time(Path(self.name), track.stamps_ns, images_ns.tolist())
            images_ns = images_ns[_nearest(images_ns, track.stamps_ns)[0]]
            at = in_camera(view, track.parent, track.at)
        found = at(images_ns)
        return {"stamp_ns": images_ns[found.valid], "T": found.values[found.valid]}

    def _selected(self, views: Mapping[str, Recording]) -> dict[str, Rows]:
        """The rows of each instrument of a log, as their columns name both; without a name they are the first one's."""
        rows, first = self.table or {}, next(iter(views))
        for column, known in (("recording", [views[first].name]), ("instrument", list(views))):
            if column in rows and not (kept := np.isin(rows[column], ["", *known])).all():
                if not kept.any():
                    others = ", ".join(np.unique(rows[column]).tolist())
                    raise RecordingError(f"{self.name}: no row of {column} {' or '.join(known)}; it has {others}")
                rows = _taken(rows, kept)
        of = rows.get("instrument", np.full(len(rows["stamp_ns"]), ""))
        found = {name: _taken(rows, np.isin(of, [name, ""] if name == first else [name])) for name in views}
        return {name: those for name, those in found.items() if len(those["stamp_ns"])}

    def _near(self, rows: Rows, view: Recording, images_ns: Stamps) -> Rows:
        """The rows that are nearest to an image, at its stamp, with their poses in the camera frame."""
        order = sort_stamps(rows["stamp_ns"])
        if (twice := len(rows["stamp_ns"]) - len(order)) > 0:
            LOG.warning("warning: %s: %d rows have the stamp of an earlier row, which counts", self.name, twice)
        rows, frames = _taken(rows, order), np.unique(rows.get("frame_id", np.array([""]))).tolist()
        if len(frames) > 1:
            raise RecordingError(f"{self.name}: poses in several frames: {', '.join(frames)}")
        poses = Sampled(rows["T"], np.ones(len(rows["T"]), np.bool_))
        try:
            T = in_camera(view, frame_name(frames[0]), lambda _: poses)(rows["stamp_ns"]).values
        except RecordingError as problem:
            raise RecordingError(f"{self.name}: column frame_id: {problem}") from None
        require_common_time(Path(self.name), rows["stamp_ns"], images_ns.tolist())
        images, places = _nearest(images_ns, rows["stamp_ns"])
        return {**_taken({**rows, "T": T}, places), "stamp_ns": images_ns[images]}

    @cached_property
    def _places(self) -> dict[tuple[str, int], int]:
        rows = (self.rows or {}).items()
        return {(name, ns): at for name, of in rows for at, ns in enumerate(of["stamp_ns"].tolist())}

    def estimate(self, frame: Frame) -> FrameResult:
        """The row of an image; a status other than `ok` is why it has no distance."""
        name, result = frame.arm.profile.instrument_name, FrameResult(frame.stamp_ns, Status.OK)
        if self.rows is None or (at := self._places.get((name, frame.stamp_ns))) is None:
            return result.rejected(Status.NO_ESTIMATE, f"no row of {self.name}")
        row = {key: values[at] for key, values in self.rows[name].items()}
        if (status := str(row.get("status", Status.OK))) != Status.OK:
            known = status in list(Status)
            return result.rejected(Status(status) if known else Status.NO_ESTIMATE, "" if known else status)
        scalars = {key: value for key, value in row.items() if np.ndim(value) == 0 and key not in TEXTS}
        number = {key: float(value) for key, value in scalars.items() if math.isfinite(value)}
        given = {key: Distance(number[key], number.get(f"{key}_std")) for key in DISTANCES if key in number}
        distances, T = Distances(**given), row["T"]
        if np.isfinite(T[:3, 3]).all():
            covariance = np.diag([number.get("tool_std", np.nan) ** 2] * 3 + [np.nan] * 3)
            tool = ToolEstimate(ToolPose(T, covariance, np.full(3, np.nan), np.nan), frame.joints)
            result = with_tool(result, frame, tool)
            distances = self._measured(frame, tool) if self.sees_tissue else distances
        elif not given:
            return result.rejected(Status.NOT_FINITE, f"a row of {self.name} without a number")
        return replace(result, distances=distances)

    def _measured(self, frame: Frame, tool: ToolEstimate) -> Distances:
        """From a pose to the tissue, without deviations; a clearance where joints bend the instrument's model."""
        pose, found = tool.pose, frame.scene.tissue
        tissue = None if found is None else found.pose
        if tissue is not None and self.on_surface:
            tissue = surface_by_stereo(frame, tissue)
        if tissue is None:
            return Distances()
        offset_m, clearance = pose.position_m - tissue.position_m, None
        planar, spatial = (Distance(float(np.linalg.norm(offset_m[:count]))) for count in (2, 3))
        if frame.arm.body is not None and tool.joints is not None and np.isfinite(pose.T_camera_tool).all():
            gap = separation(frame.arm.body.posed(tool), tissue.surface)
            clearance = Distance(gap.distance_m, None, as_vector(gap.direction), as_vector(gap.on_instrument_m))
        return Distances(planar, spatial, clearance)


def given_estimates(text: str) -> Given:
    """What `--estimates` names: FILE, topic:/NAME, or either behind NAME=; SourceError for a file that has none."""
    name, equals, source = text.partition("=")
    if not equals or Path(text).exists():
        name, source = "", text
    if source.startswith(TOPIC):
        topic = source.removeprefix(TOPIC)
        return Given(name or topic, topic=topic)
    path = Path(source)
    return Given(name or path.stem, read_estimates(path), digest=hashlib.sha256(path.read_bytes()).hexdigest())


def require_distinct(names: Sequence[str]) -> None:
    """Raise UsageError where two methods go by one name."""
    if twice := [name for at, name in enumerate(names) if name in names[:at]]:
        raise UsageError(f"two methods are called {twice[0]}: name one, as in --estimates mine=FILE")


def _taken(rows: Rows, kept: NDArray[np.bool_] | NDArray[np.intp]) -> Rows:
    return {name: values[kept] for name, values in rows.items()}


def _nearest(images_ns: Stamps, rows_ns: Stamps) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Places of images and rows, both sorted, that are each other's nearest, within what is interpolated elsewhere.

    Each row is of one image, so that a frame that was left out does not have its neighbour's.
    """

    def nearest(of: Stamps, among: Stamps) -> NDArray[np.intp]:
        right = np.minimum(np.searchsorted(among, of), len(among) - 1)
        left = np.maximum(right - 1, 0)
        return np.asarray(np.where(np.abs(of - among[left]) < np.abs(among[right] - of), left, right))

    rows = nearest(images_ns, rows_ns)
    is_near = np.abs(rows_ns[rows] - images_ns) <= MAX_GAP_NS
    images = np.flatnonzero(is_near & (nearest(rows_ns, images_ns)[rows] == np.arange(len(images_ns))))
    return images, rows[images]
