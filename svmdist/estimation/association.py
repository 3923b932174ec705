"""Association: which coloured regions, dark pixels and shapes of an image belong to which instrument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.across_views import disagreement, sides_beside
from svmdist.estimation.coloured_regions import (
    ColouredRegions,
    DarkPixels,
    NominalInstrument,
    ShaftAxis,
    nominal_instrument,
)
from svmdist.estimation.frame import Frame, OtherMasks
from svmdist.estimation.region_tracking import (
    CONTEST,
    MAX_REGIONS,
    Blob,
    Identity,
    RegionTracker,
    ranked_assignments,
)
from svmdist.estimation.scene import Arm, Scene
from svmdist.profile.robot import EntrySide
from svmdist.samples import Image, Observation
from svmdist.transforms import Array, inverse
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.instruments.find_instruments import AutoMasks, SeenInstrument

PLACED_FRACTION = 0.05  # of the width: a hidden region less certain than this assigns no shaft
SIDE_STD = 0.25  # from the middle of its side, over the image's size, for a new instrument
ENTRY_STD = 0.04  # from the previous entry: the outline is found a little longer or wider
ENTRY_SPEED = 0.05  # how that grows, per s: a trocar holds the instrument, and the camera moves slowly
END_STD = 0.06  # the same for the shaft's end
END_SPEED = 0.3  # the same for the shaft's end, per s, as instruments move
UNSEEN_COST = 6.0  # -log of the chance that an instrument is not seen although it is there, or is not there
UNNAMED_COST = 6.0  # -log of the chance that what is seen as an instrument is none of those in the profile

FOLLOWED_S = 0.5  # after which an instrument may be anywhere

SIDES: dict[EntrySide, tuple[float, float]] = {
    "left": (0.0, 0.5),
    "right": (1.0, 0.5),
    "above": (0.5, 0.0),
    "below": (0.5, 1.0),
}
"""The middle of each side of a picture, over its size."""


@dataclass(frozen=True, slots=True)
class NamedInstrument:
    """Which of an image's seen instruments an instrument is, None where it is not seen, and why that is in doubt."""

    seen: int | None
    doubt: str = ""


@dataclass
class _Track:
    """Where an instrument came in and ended when it was last seen for sure, over the image's size; None before."""

    side: Array | None
    entry: Array | None = None
    end: Array | None = None
    stamp_ns: int = 0


class EntryTracker:
    """Names the seen instruments of one camera's images, in the order of their stamps."""

    def __init__(
        self, names: Sequence[str], sides: Sequence[EntrySide | None], size: tuple[int, int]
    ) -> None:
        self._names = tuple(names)
        self._size = np.array([size[1], size[0]], np.float64)
        self._tracks = [_Track(_side(side, at, len(sides))) for at, side in enumerate(sides)]

    def update(
        self, stamp_ns: int, seen: Sequence[SeenInstrument], unlike: Array | float = 0.0
    ) -> tuple[NamedInstrument, ...]:
        """Name the seen instruments of the next image; an entry for each name.

        `unlike`, shape (n_names, n_seen), is the -log likelihood of each by another view, where there is one.
        """
        places = [(one.entry_px / self._size, one.end_px / self._size) for one in seen]
        cost = np.array([[self._cost(track, stamp_ns, *place) for place in places] for track in self._tracks])
        # What is surer an instrument is the likelier one where one name has a choice.
        cost = cost - np.log(np.array([max(one.evidence, 1e-3) for one in seen])) + unlike
        hypotheses = ranked_assignments(cost, UNNAMED_COST, UNSEEN_COST)
        named = []
        for place, at in enumerate(hypotheses[0][1]):
            doubt = "" if at is None else self._doubt(place, hypotheses)
            named.append(NamedInstrument(at, doubt))
            if at is not None and not doubt:
                track = self._tracks[place]
                (track.entry, track.end), track.stamp_ns = places[at], stamp_ns
        return tuple(named)

    def _cost(self, track: _Track, stamp_ns: int, entry: Array, end: Array) -> float:
        """-log likelihood of a seen instrument under a track, up to a constant that all tracks share."""
        if track.entry is None or track.end is None:
            off = np.zeros(2) if track.side is None else entry - track.side
            return 0.5 * float(off @ off) / SIDE_STD**2 + 2.0 * math.log(SIDE_STD)
        passed_s = max(0.0, (stamp_ns - track.stamp_ns) / 1e9)
        entry_std = min(ENTRY_STD + ENTRY_SPEED * passed_s, SIDE_STD)
        end_std = min(END_STD + END_SPEED * passed_s, SIDE_STD)
        from_entry, from_end = entry - track.entry, end - track.end
        of_entry = 0.5 * float(from_entry @ from_entry) / entry_std**2 + 2.0 * math.log(entry_std)
        # Ends say nothing more once they may be anywhere.
        of_end = 0.5 * float(from_end @ from_end) / end_std**2 + 2.0 * math.log(end_std / SIDE_STD)
        return of_entry + of_end

    def _doubt(self, place: int, hypotheses: Sequence[tuple[float, tuple[int | None, ...]]]) -> str:
        """Why a name is in doubt: another naming of this instrument, or of this name, is nearly as likely."""
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


def _side(side: EntrySide | None, at: int, count: int) -> Array | None:
    """Where an instrument is expected to come in, shape (2,) over the picture's size: in order, from left to right."""
    if side is not None:
        return np.array(SIDES[side])
    if count == 1:
        return None
    angle = np.pi * (1.0 - at / (count - 1))
    return np.array([0.5 + 0.5 * np.cos(angle), 0.5 - 0.5 * np.sin(angle)])


def _other_than(own: int | None, seen: Sequence[SeenInstrument]) -> Image | None:
    """The mask, shape (h, w), of all seen instruments but one; None where there is no other."""
    rest = [one.mask for at, one in enumerate(seen) if at != own]
    if not rest:
        return None
    others = np.bitwise_or.reduce(rest)
    return np.asarray(others if own is None else others & ~seen[own].mask, np.uint8)


def _assigned(cost: Sequence[Array | None], count: int) -> Sequence[int | None]:
    """For each instrument the likeliest of `count` that another view shows, by -log likelihoods; None for none."""
    none = np.full(count, np.inf)
    rows = np.array([none if row is None else row for row in cost])
    return ranked_assignments(rows, UNNAMED_COST, UNSEEN_COST)[0][1]


def _seek(context: FrameContext, sides: Array | None) -> None:
    if sides is not None and isinstance(context.masks, AutoMasks):
        context.masks.seek(sides)


class Association:
    """Tells the instruments of a recording apart; keeps their tracks between images."""

    def __init__(self, arms: Sequence[Arm]) -> None:
        self._arms = tuple(arms)
        self._gate = arms[0].profile.segmentation.instrument
        self._settings = arms[0].profile.settings.association
        self._trackers: dict[str, RegionTracker] = {}
        self._entries: tuple[EntryTracker, EntryTracker] | None = None  # of the left and of the right view
        self._before: list[SeenInstrument] = []
        self._before_ns = 0

    def frames(self, scene: Scene, observations: Sequence[Observation]) -> list[Frame]:
        """The frame of each instrument, with the others' pixels marked; `observations` are one per instrument."""
        robots = [arm.state_at(seen) for arm, seen in zip(self._arms, observations, strict=True)]
        nominal = [nominal_instrument(arm, robot) for arm, robot in zip(self._arms, robots, strict=True)]
        others: list[OtherMasks] = [(None, None)] * len(self._arms)
        doubts = [""] * len(self._arms)
        seen = scene.left.masks.seen
        if seen is not None and not any(nominal):
            others, doubts = self._by_entries(scene)
        elif len(self._arms) > 1 or (seen is not None and len(seen) > 1):
            others = self._others(scene, nominal)
        each = zip(self._arms, observations, robots, others, doubts, strict=True)
        return [Frame.of(scene, *one) for one in each]

    def _by_entries(self, scene: Scene) -> tuple[list[OtherMasks], list[str]]:
        """Where no robot tells where its instrument is: by the sides they come in from, and across the views."""
        stamp_ns, right = scene.observation.stamp_ns, scene.right
        # What the image before shows and this one was not found to is sought where it was.
        for before in self._before if abs(stamp_ns - self._before_ns) < 1e9 * FOLLOWED_S else ():
            _seek(scene.left, before.sides)
        seen = (scene.left.masks.seen or ())[:MAX_REGIONS]
        if self._entries is None:
            profiles = [arm.profile for arm in self._arms]
            names, sides = [one.instrument_name for one in profiles], [one.entry for one in profiles]
            shapes = scene.left.shape, (right or scene.left).shape
            self._entries = EntryTracker(names, sides, shapes[0]), EntryTracker(names, sides, shapes[1])
        beside, cost = self._across_views(scene, seen)
        # What the right view does not show, or elsewhere than at its depth, is as likely none of them.
        unlike = np.min(np.minimum(cost, UNNAMED_COST), 2) if len(beside) else np.zeros(cost.shape[:2])
        named = self._entries[0].update(stamp_ns, seen, unlike)
        self._before, self._before_ns = [seen[one.seen] for one in named if one.seen is not None], stamp_ns
        if right is None:
            return [(_other_than(one.seen, seen), None) for one in named], [one.doubt for one in named]
        return self._in_both_views(scene, seen, named, cost)

    def _in_both_views(
        self, scene: Scene, seen: Sequence[SeenInstrument], named: Sequence[NamedInstrument], cost: Array
    ) -> tuple[list[OtherMasks], list[str]]:
        """The same of both views: what one of them shows is sought in the other one.

        What that does not show, either, is measured by the one alone. `cost` is that of `_across_views` so far.
        """
        assert self._entries is not None
        # What the left view shows is sought in the right one, where it is at the depth of the instrument's radius.
        for i, one in enumerate(named):
            if one.seen is not None and cost[i, one.seen].min(initial=np.inf) > UNNAMED_COST:
                self._seek_in_other(scene, i, seen[one.seen], is_left=True)
        beside, cost = self._across_views(scene, seen)
        own = [None if one.seen is None else cost[i, one.seen] for i, one in enumerate(named)]
        paired = _assigned(own, len(beside))

        # What the right view alone shows is named by where it comes in there, and sought in the left one.
        unlike = np.full(cost.shape[::2], np.inf)
        for i, (one, at) in enumerate(zip(named, paired, strict=True)):
            if at is not None:
                unlike[i, at] = 0.0
            elif one.seen is None:
                unlike[i, [place not in paired for place in range(len(beside))]] = 0.0
        there = self._entries[1].update(scene.observation.stamp_ns, beside, unlike)
        alone = [
            None if one.seen is not None else other.seen for one, other in zip(named, there, strict=True)
        ]
        known = len(scene.left.masks.seen or ())
        for i, at in enumerate(alone):
            if at is not None:
                self._seek_in_other(scene, i, beside[at], is_left=False)
        seen = scene.left.masks.seen or ()
        _, cost = self._across_views(scene, seen[known:])
        own = [None if at is None else cost[i, :, at] for i, at in enumerate(alone)]
        found = [None if at is None else known + at for at in _assigned(own, len(seen) - known)]
        self._before += [seen[at] for at in found if at is not None]

        others, doubts = list[OtherMasks](), list[str]()
        for i, one in enumerate(named):
            at, at_right, name = (
                (found[i], alone[i], there[i]) if one.seen is None else (one.seen, paired[i], one)
            )
            others.append((_other_than(at, seen), _other_than(at_right, beside)))
            doubts.append(name.doubt)
        return others, doubts

    def _seek_in_other(self, scene: Scene, i: int, seen: SeenInstrument, is_left: bool) -> None:
        """Look in the other view for what one of them shows of an instrument, at the depth of its radius."""
        instrument, right = self._arms[i].profile.instrument, scene.observation.right
        if instrument is None or scene.right is None or right is None:
            return
        cameras, radius_m = (scene.observation.camera, right.camera), instrument.shaft_radius_m
        if is_left:
            _seek(scene.right, sides_beside(seen, cameras, inverse(right.T_left_right), radius_m))
        else:
            _seek(scene.left, sides_beside(seen, cameras[::-1], right.T_left_right, radius_m))

    def _across_views(
        self, scene: Scene, seen: Sequence[SeenInstrument]
    ) -> tuple[Sequence[SeenInstrument], Array]:
        """What the right view shows, and -log likelihood, (n_arms, n_left, n_right), that the left one shows it."""
        right = scene.observation.right
        beside = (() if scene.right is None else scene.right.masks.seen or ())[:MAX_REGIONS]
        cost = np.zeros((len(self._arms), len(seen), len(beside)))
        if right is None:
            return beside, cost
        cameras, T_right_left = (scene.observation.camera, right.camera), inverse(right.T_left_right)
        for i, instrument in enumerate(arm.profile.instrument for arm in self._arms):
            if instrument is not None:
                rows = ([disagreement(a, b, cameras, T_right_left, instrument) for b in beside] for a in seen)
                cost[i] = 0.5 * np.array(list(rows)).reshape(cost[i].shape)
        return beside, cost

    def _others(self, scene: Scene, nominal: Sequence[NominalInstrument | None]) -> list[OtherMasks]:
        seen = scene.observation
        left = self._other_masks("left", seen.stamp_ns, scene.left, seen.camera, nominal)
        if seen.right is None or scene.right is None:
            return [(mask, None) for mask in left]
        T_right_left = inverse(seen.right.T_left_right)
        beside = [tool.moved(T_right_left) if tool else None for tool in nominal]
        right = self._other_masks("right", seen.stamp_ns, scene.right, seen.right.camera, beside)
        return list(zip(left, right, strict=True))

    def _other_masks(
        self,
        name: str,
        stamp_ns: int,
        context: FrameContext,
        camera: Camera,
        nominal: Sequence[NominalInstrument | None],
    ) -> Sequence[Image | None]:
        """For each instrument the mask, shape (h, w), of coloured and dark pixels that are not its own."""
        height, width = context.shape
        tracker = self._trackers.setdefault(name, RegionTracker(len(nominal), width, height, self._settings))
        seen = context.masks.seen
        if seen is not None:
            ends = [Blob(one.end_px, 0.25 * np.pi * one.width_px**2) for one in seen]
            expected = [tool.shaft_end(camera) if tool else None for tool in nominal]
            alike = [[tool.likeness(one, camera) if tool else 0.0 for one in seen] for tool in nominal]
            found = tracker.update(stamp_ns, expected, ends, np.array(alike).reshape(len(nominal), -1))
            return [_other_than(identity.blob, seen) for identity in found]
        regions = ColouredRegions.of(context.masks.instrument, self._gate)
        shafts = context.masks.shaft
        dark = None if shafts is None else DarkPixels.of(shafts, context.masks.black)

        # Whose the regions are, by where they are expected and by whose shaft is behind them.
        evidence = np.zeros((len(nominal), len(regions.blobs)))
        for i, tool in enumerate(nominal):
            for a, blob in enumerate(regions.blobs):
                axis = tool.shaft_from(blob.centre_px, blob.radius_px, camera) if tool else None
                if axis is not None and dark is not None:
                    evidence[i, a] = dark.evidence(axis)
        places = [tool.place(camera) if tool else None for tool in nominal]
        identities = tracker.update(stamp_ns, places, regions.blobs, evidence)

        # What is not one's own: the other regions, and the pixels of the other shafts.
        masks = [regions.without(identity.blob) for identity in identities]
        if dark is not None:
            pairs = zip(nominal, identities, strict=True)
            owner = dark.by_axis([self._axis(tool, identity, regions, camera) for tool, identity in pairs])
            for i, mask in enumerate(masks):
                mask[(owner >= 0) & (owner != i)] = 255
        return masks

    def _axis(
        self,
        tool: NominalInstrument | None,
        identity: Identity,
        regions: ColouredRegions,
        camera: Camera,
    ) -> ShaftAxis | None:
        expected, radius_px = identity.expected, identity.radius_px
        if tool is not None and identity.blob is not None:
            blob = regions.blobs[identity.blob]
            return tool.shaft_from(blob.centre_px, blob.radius_px, camera)
        if tool is None or expected is None or radius_px is None:
            return None
        is_placed = expected.std_px <= PLACED_FRACTION * camera.width_px
        return tool.shaft_from(expected.mean, radius_px, camera) if is_placed else None
