"""Association of instruments without kinematics: by sides they come in from, where they were, and across views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.frame import Arm, Frame, Scene
from svmdist.estimation.region_tracking import MAX_REGIONS, ranked_assignments
from svmdist.profile.robot import EntrySide, Instrument
from svmdist.results import Pixel
from svmdist.samples import Image
from svmdist.transforms import Array, inverse, transform_points
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.lines import axis_of_cylinder, line_between, tangent_normal

SIDE_STD = 0.25  # from the middle of its side, over the image's size, for a new instrument
ENTRY_STD = 0.04  # from the previous entry: the outline is found a little longer or wider
ENTRY_SPEED = 0.05  # how that grows, per s: a trocar holds the instrument, and the camera moves slowly
END_STD = 0.06  # the same for the shaft's end
END_SPEED = 0.3  # the same for the shaft's end, per s, as instruments move
UNSEEN_COST = 6.0  # -log of the chance that an instrument is not seen although it is there, or is not there
UNNAMED_COST = 6.0  # -log of the chance that what is seen as an instrument is none of those in the profile
CONTEST = 4.6  # a name is ambiguous where another naming is more than a hundredth (e^-4.6) as likely

ENDS_STD_WIDTHS = 0.5  # of the shaft's end along it, over its width: one view may show the dark part's
WIDTH_STD = 0.08  # logarithm of the width in one view: shade and blur take a pixel of it
LINE_STD_PX = 1.5  # of a middle line, in pixels of the working image

SIDE_MIDDLES: dict[EntrySide, Pixel] = {"left": (0, 0.5), "right": (1, 0.5), "above": (0.5, 0), "below": (0.5, 1)}
"""The middle of each side of a picture, over its size."""
Cameras = tuple[Camera, Camera]


@dataclass
class _Track:
    """Where an instrument came in and ended when it was last seen for sure, over the image's size; None before."""

    side: Array | None  # where it is expected to come in
    place: tuple[Array, Array] | None = None
    stamp_ns: int = 0


class EntryTracker:
    """Names the seen instruments of one camera's images, in the order of their stamps."""

    def __init__(self, names: Sequence[str], sides: Sequence[EntrySide | None]) -> None:
        self._names, self._tracks, self._guess = tuple(names), list[_Track](), ""
        for at, side in enumerate(sides):
            place = None if side is None else np.array(SIDE_MIDDLES[side])
            if side is None and len(sides) > 1:
                self._guess = "instruments are named from left to right: the profile has no entry"
                angle = np.pi * (1.0 - at / (len(sides) - 1))
                place = np.array([0.5 + 0.5 * np.cos(angle), 0.5 - 0.5 * np.sin(angle)])
            self._tracks.append(_Track(place))

    def update(
        self, stamp_ns: int, seen: Sequence[SeenInstrument], unlike: Array | float = 0.0
    ) -> tuple[list[int | None], list[str]]:
        """Say for each name which of the next image's seen instruments it is, None for none, and why that is ambiguous.

        `unlike`, shape (n_names, n_seen), is the -log likelihood of each by another view, where there is one.
        """
        places = [(one.entry_px / one.size[::-1], one.end_px / one.size[::-1]) for one in seen]
        cost = np.array([[self._cost(track, stamp_ns, *place) for place in places] for track in self._tracks])
        # What is surer an instrument is the likelier one where one name has a choice.
        cost = cost - np.log(np.array([max(one.evidence, 1e-3) for one in seen])) + unlike
        hypotheses = ranked_assignments(cost, UNNAMED_COST, UNSEEN_COST)
        named, ambiguities = list(hypotheses[0][1]), [""] * len(self._tracks)
        for i, (track, at) in enumerate(zip(self._tracks, named, strict=True)):
            if at is not None:
                ambiguity = self._ambiguity(i, hypotheses)
                ambiguities[i] = ambiguity or self._guess
                if not ambiguity:
                    track.place, track.stamp_ns = places[at], stamp_ns
        return named, ambiguities

    def _cost(self, track: _Track, stamp_ns: int, entry: Array, end: Array) -> float:
        """-log likelihood of a seen instrument under a track, up to a constant that all tracks share."""

        def cost(off: Array, std: float) -> float:
            return 0.5 * float(off @ off) / std**2 + 2.0 * math.log(std)

        if track.place is None:
            return cost(np.zeros(2) if track.side is None else entry - track.side, SIDE_STD)
        passed_s = max(0.0, (stamp_ns - track.stamp_ns) / 1e9)
        of_entry = cost(entry - track.place[0], min(ENTRY_STD + ENTRY_SPEED * passed_s, SIDE_STD))
        # Ends say nothing more once they may be anywhere.
        of_end = cost(end - track.place[1], min(END_STD + END_SPEED * passed_s, SIDE_STD))
        return of_entry + of_end - 2.0 * math.log(SIDE_STD)

    def _ambiguity(self, place: int, hypotheses: Sequence[tuple[float, tuple[int | None, ...]]]) -> str:
        """Why a name is ambiguous: another naming of this instrument, or of this name, is nearly as likely."""
        best_cost, best = hypotheses[0]
        at = best[place]
        for cost, other in hypotheses[1:]:
            if cost - best_cost > CONTEST:
                return ""
            if other[place] == at:
                continue
            names = [self._names[rival] for rival, taken in enumerate(other) if taken == at]
            if names:
                return f"cannot tell whether this is {self._names[place]} or {names[0]}"
            if other[place] is not None:
                return f"cannot tell which of the instruments seen is {self._names[place]}"
        return ""


class EntryAssociation:
    """The seen instruments of a recording in one view or two, by name; keeps where they were between images."""

    def __init__(self, arms: Sequence[Arm]) -> None:
        profiles = [arm.profile for arm in arms]
        self._instruments = [one.instrument for one in profiles]
        names, sides = [one.instrument_name for one in profiles], [one.entry for one in profiles]
        self._left, self._right = EntryTracker(names, sides), EntryTracker(names, sides)

    def mark_others(self, scene: Scene, frames: Sequence[Frame]) -> list[str]:
        """Mark in each instrument's views the pixels of others; gives why it is not sure which one it is."""
        stamp_ns, pair = scene.observation.stamp_ns, scene.observation.right
        seen = (scene.left.masks.seen or ())[:MAX_REGIONS]
        beside = (() if scene.right is None else scene.right.masks.seen or ())[:MAX_REGIONS]
        # -log likelihood that the left view shows what the right one does, of each instrument.
        cost = np.zeros((len(self._instruments), len(seen), len(beside)))
        if pair is not None:
            cameras, T_right_left = (scene.observation.camera, pair.camera), inverse(pair.T_left_right)
            for i, a, b in np.ndindex(cost.shape):
                if (instrument := self._instruments[i]) is not None:
                    cost[i, a, b] = 0.5 * disagreement(seen[a], beside[b], cameras, T_right_left, instrument)
        # What the right view does not show, or elsewhere than at its depth, is as likely none of them.
        unlike = np.min(np.minimum(cost, UNNAMED_COST), 2) if len(beside) else np.zeros(cost.shape[:2])
        left, ambiguities = self._left.update(stamp_ns, seen, unlike)
        for frame, at in zip(frames, left, strict=True):
            frame.left.others = other_than(at, seen)
        if scene.right is None:
            return ambiguities
        rows = np.array([np.full(len(beside), np.inf) if at is None else cost[i, at] for i, at in enumerate(left)])
        right = list(ranked_assignments(rows, UNNAMED_COST, UNSEEN_COST)[0][1])

        # What the right view alone shows is named by where it comes in there.
        unlike = np.full(cost.shape[::2], np.inf)
        for i, at in enumerate(right):
            if at is not None:
                unlike[i, at] = 0.0
            elif left[i] is None:
                unlike[i, [place not in right for place in range(len(beside))]] = 0.0
        there, ambiguities_there = self._right.update(stamp_ns, beside, unlike)
        for i, at in enumerate(left):
            if at is None:
                right[i], ambiguities[i] = there[i], ambiguities_there[i]
        for view, at in zip([frame.right for frame in frames], right, strict=True):
            if view is not None:
                view.others = other_than(at, beside)
        return ambiguities


def other_than(own: int | None, seen: Sequence[SeenInstrument]) -> Image | None:
    """The mask, shape (h, w), of all seen instruments but one; None where there is no other."""
    rest = [one.mask for at, one in enumerate(seen) if at != own]
    if not rest:
        return None
    others = np.bitwise_or.reduce(rest)
    return np.asarray(others if own is None else others & ~seen[own].mask, np.uint8)


def sides_beside(seen: SeenInstrument, cameras: Cameras, T_other_own: Array, radius_m: float) -> Array | None:
    """Where one camera has the sides of a shaft of a radius that another one shows, (2, 2, 2) in px, or None."""
    ends = cameras[0].rays(seen.sides)[:, :2].reshape(2, 2, 2)
    planes = [line_between(side, np.zeros((2, 2)), ends.mean((0, 1))) for side in ends]
    axis = axis_of_cylinder(planes, radius_m)
    if axis is None:
        return None
    rays = np.column_stack([ends.mean(0), np.ones(2)])
    own_m = np.array([axis.depth_m(ray) * ray for ray in rays])
    points_m = transform_points(T_other_own, own_m)
    along = (points_m[1] - points_m[0]) / max(float(np.linalg.norm(points_m[1] - points_m[0])), 1e-9)
    normals = [tangent_normal(points_m[1], along, radius_m, side)[0] for side in (-1, 1)]
    if not (min(own_m[:, 2].min(), points_m[:, 2].min()) > radius_m and np.isfinite(normals).all()):
        return None
    return np.array([cameras[1].project(points_m - radius_m * normal) for normal in normals])


def disagreement(
    left: SeenInstrument, right: SeenInstrument, cameras: Cameras, T_right_left: Array, instrument: Instrument
) -> float:
    """Squared deviations of the right view's shaft from where the left one's width puts it; infinite behind cameras."""
    # The depth by the radius says where along their epipolar lines both ends of the left middle line are visible.
    radius_m, fraction = instrument.shaft_radius_m, np.hypot(instrument.shaft_radius_std_fraction, WIDTH_STD)
    depths = (radius_m, radius_m * (1.0 + fraction))
    near, far = (sides_beside(left, cameras, T_right_left, one) for one in depths)
    if near is None or far is None:
        return np.inf
    entry_px, end_px = right.sides.mean(0)
    moved_px, off_px, along = (far - near).mean(0), near.mean(0) - end_px, end_px - entry_px
    along /= max(float(np.linalg.norm(along)), 1e-9)
    normal = np.array([-along[1], along[0]])
    across = (off_px @ normal) / np.hypot(moved_px @ normal, LINE_STD_PX * (left.pixel_px + right.pixel_px))
    ends_px = [min(one.end_std_px, 1e6) for one in (left, right)]
    of_end = off_px[1] @ along / np.linalg.norm([moved_px[1] @ along, ENDS_STD_WIDTHS * right.width_px, *ends_px])
    of_width = np.log(right.width_px / np.linalg.norm(near[0, 1] - near[1, 1])) / (np.sqrt(2.0) * WIDTH_STD)
    return float(across @ across + of_end**2 + of_width**2)
