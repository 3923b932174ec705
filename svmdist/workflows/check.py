"""A look at some images of all of a log before its first row: the offset of rows, comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import RecordingError
from svmdist.estimation import checks
from svmdist.estimation.association import Association
from svmdist.estimation.checks import Matches
from svmdist.estimation.comparison import KINEMATICS, ROWS, Checks, Difference
from svmdist.estimation.frame import Arm, Frame, Scene
from svmdist.estimation.frame_methods import places_of
from svmdist.profile import Profile
from svmdist.profile.robot import Tissue
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.recording.log import Recording
from svmdist.recording.observations import EncodedObservation
from svmdist.results import Failure, ToolPose
from svmdist.samples import Observation, Rejection
from svmdist.transforms import Array
from svmdist.vision.colour import to_grey
from svmdist.vision.frame_context import as_pinholes, with_first_fields
from svmdist.vision.segmentation import Segmenter, make_segmenter
from svmdist.vision.stereo import LEVEL, RowAlignment, agreed_offset, corresponding_points, rectified_pair
from svmdist.vision.tags import find_tags
from svmdist.workflows.request import CLEAN, Condition

CHECKED = 6  # images, and up to twice as many, evenly over the log
LOOKED_AT = 3  # of them before the first row; the others are where one of these differs by more than
SUSPECT_DEVIATIONS = 2.5
MIN_ROW_OFFSET_PX = 0.5  # a smaller one is left: it does less harm than shifting an image between its pixels

SOMEWHERE = Tissue(plane_distance_m=0.1)
"""Where an endoscope works, of a profile without a tissue: instruments and both views can be compared all the same."""


def spread_observations(recording: Recording, count: int = CHECKED) -> list[EncodedObservation]:
    """Up to twice `count` of a log's observations, evenly from its beginning to its end; none of a video that froze.

    The log is read once, its length unknown: of those kept every second one goes whenever there are too many, so that
    memory does not grow with the log.
    """
    kept: list[EncodedObservation] = []
    stride = 1
    every = recording.encoded_observations(robot=False, stale=True)
    for place, one in enumerate(image for image in every if not image.repeats):
        if place % stride == 0:
            kept.append(one)
        if len(kept) > 2 * count:
            kept, stride = kept[::2], 2 * stride
    return recording.with_states(kept)


def offset_to_remove(pairs: Sequence[Observation], profile: Profile) -> RowAlignment:
    """The offset between the rows of both views where pairs show it and it is worth removing; else none.

    Halved views show it where they show enough; of paper and of cameras far from each other it takes whole ones.
    """
    pairs = [one for one in pairs if one.right is not None]
    for step in (2, 1) if pairs else ():
        offset_px = agreed_offset(np.concatenate([_row_differences(one, profile, step) for one in pairs]))
        if offset_px is not None:
            return LEVEL if abs(offset_px) < MIN_ROW_OFFSET_PX else RowAlignment(offset_px)
    return LEVEL


def first_of(spread: Sequence[EncodedObservation], profile: Profile) -> list[Observation]:
    """The images that the offset of rows is found from."""
    count = profile.stereo_in_range.row_pairs
    few = spread[:: max(1, len(spread) // max(count, 1))][:count]
    return [one.decoded.seen[0] for one in few if one.decoded.seen is not None]


def _row_differences(seen: Observation, profile: Profile, step: int) -> Array:
    """Row in the right view less that in the left one, (n,) in px."""
    seen = as_pinholes(with_first_fields(seen, profile.settings.interlace))
    right, settings = seen.right, profile.stereo_in_range
    assert right is not None  # asked for before
    pair = rectified_pair(seen.camera, right)
    if isinstance(pair, Failure):
        return np.zeros(0)
    bounds_px = pair.disparity_at(settings.far_m), pair.disparity_at(settings.near_m)
    far_px, near_px = (bound + pair.offset_px for bound in bounds_px)
    views = to_grey(seen.image_bgr), to_grey(right.image_bgr)
    found = corresponding_points(views, pair, settings.max_row_offset_px, (far_px, near_px), step)
    return np.asarray(found[1][:, 1] - found[0][:, 1])


def arms_of(recording: Recording, profile: Profile, spread: Sequence[EncodedObservation]) -> list[Arm]:
    """The arms of a recording's instruments, with the plates of their tags where its images show any of these.

    Blood may hide one tag throughout a log, whose plate is then as wide as ever.
    """
    profiles, settings = [profile.for_instrument(name) for name in recording.instruments], profile.settings
    wanted = {one.fiducial.id for one in profiles if one.fiducial is not None}
    images = (one.decoded.seen[0] for one in spread if wanted and one.decoded.seen is not None)
    first_fields = (with_first_fields(seen, settings.interlace).image_bgr for seen in images)
    has_plates = profile.fiducial is not None and any(
        not wanted.isdisjoint(find_tags(to_grey(bgr), profile.fiducial.family, settings.tag)) for bgr in first_fields
    )
    return [Arm(one, has_plates and one.fiducial is not None) for one in profiles]


def needs_association(arms: Sequence[Arm]) -> bool:
    """Whether instruments have to be associated: there are several, or images show others as such."""
    return len(arms) > 1 or isinstance(arms[0].profile.segmentation, AutoSegmentation)


def look(seen: tuple[Observation, ...], arms: Sequence[Arm], segmenter: Segmenter, rows: RowAlignment) -> list[Frame]:
    """A frame for each instrument in an image: several are associated as in the first image of a log."""
    scene = Scene(seen[0], arms[0].profile, segmenter, rows)
    if not needs_association(arms):
        return [Frame.of(scene, arms[0], seen[0])]
    return Association(arms).frames(scene, seen)


def checked(
    recording: Recording,
    spread: Sequence[EncodedObservation],
    arms: Sequence[Arm],
    segmenter: Segmenter,
    rows: RowAlignment,
    condition: Condition = CLEAN,
    least: int = LOOKED_AT,
    pairs: int = 1,
) -> tuple[dict[str, Checks], dict[int, list[Frame]]]:
    """The comparisons of each instrument by its name, and what was looked at for them by the number of the image.

    Of a log that is about some of its instruments only, these are not compared. The `least` images from all of it, and
    points of so many `pairs`, are enough where nothing is suspect; else it is all of them.
    """
    is_part, is_associated = recording.is_part, needs_association(arms)
    changes = [(one.before.camera, one.after.camera) for one in recording.camera_changes]
    names = [arm.profile.instrument_name for arm in arms]
    by_name: dict[str, list[Difference]] = {
        name: [*checks.of_profile(arm), *checks.of_calibrations(changes, arm.profile.camera_error)]
        for name, arm in zip(names, arms, strict=True)
    }
    places: dict[str, list[dict[str, ToolPose]]] = {name: [] for name in names}
    first = np.linspace(0, len(spread) - 1, least).round().astype(int).tolist()
    order = list(dict.fromkeys([*first, *range(len(spread))])) if spread else []
    looked: dict[int, list[Frame]] = {}
    matches: list[Matches] = []

    def found() -> dict[str, list[Difference]]:
        views = list(checks.of_views(arms[0].profile, matches))
        return {name: [*by_name[name], *checks.of_motion(places[name]), *views] for name in names}

    for place in order:
        is_suspect = any(d.deviations > SUSPECT_DEVIATIONS for ones in found().values() for d in ones)
        if len(looked) >= least and not is_suspect:
            break
        number, sighted = spread[place].number, spread[place].decoded.seen
        if sighted is None:
            continue
        seen = tuple(condition.apply(one, number) for one in sighted)
        frames = looked[number] = look(seen, arms, segmenter, rows)
        scene = frames[0].scene
        shared = list(checks.of_scene(scene))
        # A surface that both views show is enough, where no method measures by both of them.
        is_wanted = is_suspect or len(matches) < pairs or not (matches or scene.stereo_surface)
        if is_wanted and (found_here := checks.matched(scene)) is not None:
            matches.append(found_here)
        for name, frame in zip(names, frames, strict=True):
            unknown = len(arms) > 1 and isinstance(frame.robot_in_camera, Failure)
            if is_part or unknown or frame.ambiguity:  # what the image shows may be another instrument
                by_name[name] += shared
                continue
            here = places_of(frame)
            differences = checks.of_frame(frame, here)
            if is_associated:  # kinematics associated the instruments: they are no independent evidence
                differences = (one for one in differences if KINEMATICS not in one.sources)
                here = {source: pose for source, pose in here.items() if source != KINEMATICS}
            places[name].append(here)
            by_name[name] += [*shared, *differences]
    return {name: Checks.of(ones, len(looked)) for name, ones in found().items()}, looked


@dataclass(frozen=True)
class ViewsCompared:
    """Both views of pairs against their cameras, and how rows are aligned where these contradict."""

    checks: Checks
    rows: RowAlignment | None

    @property
    def refusal(self) -> str:
        """Why they cannot be those of their cameras, whatever they show; empty where they can be."""
        wrong = [one for one in self.checks.comparisons if one.usual.what != ROWS]
        return warning({"": Checks(tuple(wrong))})

    @property
    def warning(self) -> str:
        """What contradicts, and what it leads to; empty where nothing does."""
        said = warning({"": self.checks})
        return f"{said}; depths are less sure the further they are from the middle" if said else ""


def compare_views(pairs: Iterable[Observation], profile: Profile) -> ViewsCompared:
    """Compare both views of pairs with their cameras."""
    segmenter = make_segmenter(profile.segmentation, profile.settings.auto)
    scenes = [Scene(one, profile, segmenter) for one in pairs if one.right is not None]
    matches = [found for scene in scenes if (found := checks.matched(scene)) is not None]
    compared = Checks.of(checks.of_views(profile, matches), len(matches))
    return ViewsCompared(compared, checks.row_alignment(matches) if compared.bends_rows else None)


def warning(found: Mapping[str, Checks]) -> str:
    """What contradicts most, and what could be wrong, in one line; empty where nothing does."""
    worst = [one for checks_of in found.values() for one in checks_of.contradictions]
    if not worst:
        return ""
    more = f" ({len(worst) - 1} more: svmdist check shows them)" if len(worst) > 1 else ""
    return f"{worst[0]}; look at {', or '.join(worst[0].could_be)}{more}"


def check_log(recording: Recording) -> dict[str, Checks]:
    """All comparisons that a log and its profile allow, by the name of the instrument; RecordingError without images.

    Images that cannot be used join the log's losses.
    """
    own = recording.origin.profile
    profile = own.model_copy(update={"tissue": own.tissue or SOMEWHERE})
    segmenter = make_segmenter(profile.segmentation, profile.settings.auto)
    spread = spread_observations(recording)
    arms = arms_of(recording, profile, spread)
    rows = offset_to_remove(first_of(spread, profile), profile)
    for one in spread:
        recording.record_losses(one.decoded)
    if spread and isinstance(why := spread[0].decoded.found, Rejection) and not any(one.decoded.seen for one in spread):
        raise RecordingError(f"{recording.name}: no image of {len(spread)} can be used: {why.detail or why.status}")
    return checked(recording, spread, arms, segmenter, rows, least=len(spread), pairs=len(spread))[0]
