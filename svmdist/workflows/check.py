"""What a log shows twice: a look at some images of all of it before its first row, and the tissue by both views."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation import checks
from svmdist.estimation.association import Association
from svmdist.estimation.comparison import KINEMATICS, ROWS, Checks, Difference
from svmdist.estimation.frame import Arm, Frame, Scene
from svmdist.estimation.frame_methods import places_of
from svmdist.estimation.tissue.surface import ALL_PX
from svmdist.profile import Profile
from svmdist.profile.robot import Tissue
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.recording.log import Recording
from svmdist.recording.messages import Kind
from svmdist.recording.observations import EncodedObservation
from svmdist.recording.source import LossKind
from svmdist.recording.summary import inspect_recording
from svmdist.recording.topics import Role
from svmdist.results import Failure, ToolPose
from svmdist.samples import Observation, Rejection
from svmdist.transforms import Array
from svmdist.vision.colour import to_grey
from svmdist.vision.frame_context import Segmenter, as_pinholes, make_segmenter, with_first_fields
from svmdist.vision.stereo import LEVEL, RowAlignment, agreed_offset, corresponding_points, rectified_pair
from svmdist.vision.tags import find_tags
from svmdist.workflows.capabilities import HEAD_S, misfit
from svmdist.workflows.request import CLEAN, Condition

CHECKED = 6  # images, and up to twice as many, evenly over the log
LOOKED_AT = 3  # of them before the first row; the others are where one of these differs by more than
SUSPECT_DEVIATIONS = 2.5
MIN_ROW_OFFSET_PX = 0.5  # a smaller one is left: it does less harm than shifting an image between its pixels

SOMEWHERE = Tissue(plane_distance_m=0.1)
"""Where an endoscope works, of a profile without a tissue: instruments and both views can be compared all the same."""


def spread_observations(recording: Recording, count: int = CHECKED) -> list[EncodedObservation]:
    """Up to twice `count` of a log's observations, evenly from its beginning to its end; none of a video that froze."""
    kept: list[EncodedObservation] = []
    stride = 1
    every = recording.encoded_observations(robot=False, stale=True)
    for place, one in enumerate(image for image in every if not image.repeats):
        if place % stride == 0:
            kept.append(one)
        if len(kept) > 2 * count:  # the log is read once, its length unknown: memory does not grow with it
            kept, stride = kept[::2], 2 * stride
    return recording.with_states(kept)


def offset_to_remove(pairs: Sequence[Observation], profile: Profile) -> RowAlignment:
    """The offset between the rows of both views where pairs show it and it is worth removing; else none.

    Halved views show it where they show enough; of paper and of cameras far from each other it takes whole ones.
    """
    pairs = [as_pinholes(with_first_fields(one, profile.settings.interlace)) for one in pairs if one.right is not None]
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
    """Row in the right view less that in the left one, (n,) in px; none without a rectified pair."""
    right, settings = seen.right, profile.stereo_in_range
    if right is None or isinstance(pair := rectified_pair(seen.camera, right), Failure):
        return np.zeros(0)
    far_px, near_px = (pair.disparity_at(at_m) + pair.offset_px for at_m in (settings.far_m, settings.near_m))
    views = to_grey(seen.image_bgr), to_grey(right.image_bgr)
    left_px, right_px = corresponding_points(views, pair, settings.max_row_offset_px, (far_px, near_px), step)
    return np.asarray(right_px[:, 1] - left_px[:, 1])


def arms_of(recording: Recording, profile: Profile, spread: Sequence[EncodedObservation]) -> list[Arm]:
    """The arms of a recording's instruments, with the plates of their tags where its images show any of these."""
    profiles, settings = [profile.for_instrument(name) for name in recording.instruments], profile.settings
    wanted = {one.fiducial.id for one in profiles if one.fiducial is not None}
    has_plates = False
    if wanted and profile.fiducial is not None:
        images = (one.decoded.seen[0] for one in spread if one.decoded.seen is not None)
        grey = (to_grey(with_first_fields(seen, settings.interlace).image_bgr) for seen in images)
        # Of any: blood may hide one tag throughout a log, whose plate is then as wide as ever.
        has_plates = any(wanted & find_tags(one, profile.fiducial.family, settings.tag).keys() for one in grey)
    return [Arm(one, has_plates and one.fiducial is not None) for one in profiles]


def needs_association(arms: Sequence[Arm]) -> bool:
    """Whether instruments have to be associated: there are several, or images show others as such."""
    return len(arms) > 1 or isinstance(arms[0].profile.segmentation, AutoSegmentation)


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

    The `least` images from all of it, and points of so many `pairs`, are enough where nothing is suspect; else it is
    all of them. A log that is about some of its instruments only is not compared in what may show another one.
    """
    is_part, is_associated = recording.is_part, needs_association(arms)
    changes = [(one.before.camera, one.after.camera) for one in recording.camera_changes]
    by_name: dict[str, list[Difference]] = {}
    places: dict[str, list[dict[str, ToolPose]]] = {}
    for arm in arms:
        of_cameras = checks.of_calibrations(changes, arm.profile.camera_error)
        by_name[arm.profile.instrument_name] = [*checks.of_profile(arm), *of_cameras]
        places[arm.profile.instrument_name] = []
    first = np.linspace(0, len(spread) - 1, least).round().astype(int).tolist()
    order = list(dict.fromkeys([*first, *range(len(spread))])) if spread else []
    looked: dict[int, list[Frame]] = {}
    matches: list[checks.Matches] = []

    def found() -> dict[str, list[Difference]]:
        views = list(checks.of_views(arms[0].profile, matches))
        return {name: [*by_name[name], *checks.of_motion(places[name]), *views] for name in by_name}

    for place in order:
        is_suspect = any(d.deviations > SUSPECT_DEVIATIONS for ones in found().values() for d in ones)
        if len(looked) >= least and not is_suspect:
            break
        number, observations = spread[place].number, spread[place].decoded.seen
        if observations is None:
            continue
        seen = tuple(condition.apply(one, number) for one in observations)
        scene = Scene(seen[0], arms[0].profile, segmenter, rows)
        # Several are associated as in the first image of a log
        frames = Association(arms).frames(scene, seen) if is_associated else [Frame.of(scene, arms[0], seen[0])]
        looked[number] = frames
        shared = list(checks.of_scene(scene))
        # A surface that both views show is enough, where no method measures by both of them.
        is_wanted = is_suspect or len(matches) < pairs or not (matches or scene.stereo_surface)
        if is_wanted and (found_here := checks.matched(scene)) is not None:
            matches.append(found_here)
        for name, frame in zip(by_name, frames, strict=True):
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


class ViewsCompared(NamedTuple):
    """Both views of pairs against their cameras; words are empty where nothing contradicts."""

    rows: RowAlignment | None = None  # how they are aligned where they contradict
    refusal: str = ""  # why the views cannot be those of their cameras, whatever they show
    warning: str = ""  # what contradicts, and what it leads to


def compare_views(pairs: Iterable[Observation], profile: Profile) -> ViewsCompared:
    """Compare both views of pairs with their cameras."""
    segmenter = make_segmenter(profile.segmentation, profile.settings.auto)
    scenes = [Scene(one, profile, segmenter) for one in pairs if one.right is not None]
    matches = [found for scene in scenes if (found := checks.matched(scene)) is not None]
    compared = Checks.of(checks.of_views(profile, matches), len(matches))
    but_rows = Checks(tuple(one for one in compared.comparisons if one.usual.what != ROWS))
    if said := warning({"": compared}):
        said += "; depths are less sure the further they are from the middle"
    rows = checks.row_alignment(matches) if compared.bends_rows else None
    return ViewsCompared(rows, warning({"": but_rows}), said)


def warning(found: Mapping[str, Checks]) -> str:
    """What contradicts most, and what could be wrong, in one line; empty where nothing does."""
    worst = [one for checks_of in found.values() for one in checks_of.contradictions]
    if not worst:
        return ""
    more = f" ({len(worst) - 1} more: svmdist check shows them)" if len(worst) > 1 else ""
    return f"{worst[0]}; look at {', or '.join(worst[0].could_be)}{more}"


def check_log(recording: Recording) -> dict[str, Checks]:
    """All comparisons that a log and its profile allow, by the instrument's name; RecordingError without images."""
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


@dataclass(frozen=True, slots=True)
class TissueSurface:
    """Points of the tissue in the left camera's frame, as one image of a log shows them."""

    points_m: Array  # (n, 3)
    normals: Array  # (n, 3), of length 1, to the camera
    std_m: Array  # (n,), standard deviations along the line of sight, by matching and calibration
    rgb: NDArray[np.uint8]  # (n, 3), the colour in the left image
    share: float  # of the tissue in the left image that is seen
    number: int  # of the image in its log, from 0
    stamp_ns: int
    frame_id: str


def tissue_surface(recording: Recording, number: int) -> TissueSurface:
    """The surface that both views of an image, by its number, show; RecordingError, or UsageError without the image."""
    if not isinstance(number, int) or number < 0:
        raise UsageError(f"expected the number of an image, 0 or more; found {number}")
    if recording.topic_of(Role.RIGHT_IMAGE) is None or recording.right_camera is None:
        summary = inspect_recording(recording, HEAD_S)
        has_two = sum(one.kind is Kind.IMAGE for one in summary.topics) > 1  # which a profile would name
        needs = "a surface needs a calibrated right view, which it has not: `svmdist import` takes two"
        raise RecordingError(f"{recording.name}: {(has_two and misfit(summary)) or needs}")
    profile = recording.origin.profile
    segmenter = make_segmenter(profile.segmentation, profile.settings.auto)
    pairs = first_of(spread_observations(recording), profile)
    views = compare_views(pairs, profile)
    if views.refusal:
        raise RecordingError(f"{recording.name} shows no surface: {views.refusal}")
    if views.warning:
        recording.health.lose(LossKind.CONTRADICTION, views.warning)
    chosen = next(islice(recording.encoded_observations(robot=False), number, None), None)
    if chosen is None:
        raise UsageError(f"{recording.name} has no image {number}")
    found, where = chosen.decode().found, f"{recording.name}: frame {number}"
    if isinstance(found, Rejection):
        raise RecordingError(f"{where} cannot be read: {found.detail or found.status}")
    scene = Scene(found[0], profile, segmenter, views.rows or offset_to_remove(pairs, profile))
    pair, right, seen = scene.stereo_pair, scene.observation.right, scene.observation
    if isinstance(pair, Failure) or right is None:
        raise RecordingError(f"{where} shows no surface: {pair.reason if isinstance(pair, Failure) else 'no pair'}")
    surface = scene.surface(most_px=ALL_PX)
    if surface is None:
        few = "too little of the tissue is found in both views (svmdist show --masks)"
        raise RecordingError(f"{where}: {misfit(inspect_recording(recording, HEAD_S)) or few}")
    is_seen = surface.is_seen
    return TissueSurface(
        surface.points_m,
        surface.normals[is_seen],
        surface.deviations_m(seen.camera, right, profile.camera_error)[is_seen],
        np.ascontiguousarray(surface.colours(seen.image_bgr, seen.camera)[:, ::-1]),
        surface.share,
        number,
        seen.stamp_ns,
        recording.logged_camera.frame_id,
    )
