"""The tissue's surface in one pair of a log's images, at full resolution."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.frame import Scene
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.tissue.surface import ALL_PX
from svmdist.recording.log import Recording
from svmdist.recording.messages import Kind
from svmdist.recording.source import LossKind
from svmdist.recording.summary import inspect_recording
from svmdist.recording.topics import Role
from svmdist.results import Failure
from svmdist.samples import Rejection
from svmdist.transforms import Array
from svmdist.vision.segmentation import make_segmenter
from svmdist.workflows.capabilities import HEAD_S, misfit
from svmdist.workflows.check import compare_views, first_of, offset_to_remove, spread_observations


@dataclass(frozen=True, slots=True)
class TissueSurface:
    """Points of the tissue in the left camera's frame, in m: `points_m` and `normals`, shape (n, 3).

    `std_m`, shape (n,), is the standard deviation along the line of sight, by matching and calibration; `rgb`, (n, 3),
    the colour in the left image. Normals have length 1 and point to the camera. `share` of the tissue in the left image
    is seen. `number` counts the log's images from 0; `stamp_ns` and `frame_id` are the image's.
    """

    points_m: Array
    normals: Array
    std_m: Array
    rgb: NDArray[np.uint8]
    share: float
    number: int
    stamp_ns: int
    frame_id: str


def tissue_surface(recording: Recording, number: int) -> TissueSurface:
    """The surface that both views of an image, by its number from 0, show: with instruments in view or without.

    Raises RecordingError where the log has no right view, or the image shows no surface; UsageError without the image.
    """
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
        surface.deviations_m(seen.camera, right, Deviations.of(profile))[is_seen],
        np.ascontiguousarray(surface.colours(seen.image_bgr, seen.camera)[:, ::-1]),
        surface.share,
        number,
        seen.stamp_ns,
        recording.logged_camera.frame_id,
    )
