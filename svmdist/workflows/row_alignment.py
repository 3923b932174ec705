"""By how many rows the views of a log's pairs are apart.

It is found from the first pairs before any row is made, so that rows do not depend on how many threads work.
"""

from __future__ import annotations

import numpy as np

from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.observations import Needs
from svmdist.results import Failure
from svmdist.samples import Observation, Rejection
from svmdist.transforms import Array
from svmdist.vision.frame_context import as_pinholes, to_grey, with_first_fields
from svmdist.vision.stereo import RowOffset, agreed_offset, rectified_pair, row_differences

ROW_STRIDE = 12  # the steps between these pairs
# A smaller offset is left: it does less harm than shifting an image between its pixels
MIN_ROW_OFFSET_PX = 0.5


def row_offset(recording: Recording, profile: Profile) -> RowOffset | None:
    """The offset between the rows of both views; None where the log has no pairs, or they do not tell it."""
    settings = profile.stereo_in_range
    needs = Needs(joints=False, transforms=False, right=True)
    encoded = recording.encoded_observations(recording.instruments[:1], needs)
    found: list[Array] = []
    end = settings.row_pairs * ROW_STRIDE
    for number, one in enumerate(encoded):
        if number >= end and recording.file.is_read:
            break  # else to the end: this pass reads the joints and transforms, too, which no other has to
        if number >= end or number % ROW_STRIDE:
            continue
        decoded = one.decode().found
        if isinstance(decoded, Rejection) or decoded[0].right is None:
            continue
        found.append(_differences(decoded[0], profile))
    return agreed_offset(np.concatenate(found)) if found else None


def row_offset_to_remove_px(recording: Recording, profile: Profile) -> float:
    """The offset where it is more than the settings leave, and known; else 0."""
    offset = row_offset(recording, profile)
    if offset is None or abs(offset.px) < MIN_ROW_OFFSET_PX:
        return 0.0
    return offset.px


def _differences(seen: Observation, profile: Profile) -> Array:
    seen = as_pinholes(with_first_fields(seen, profile.settings.interlace))
    right, settings = seen.right, profile.stereo_in_range
    assert right is not None  # asked for before
    pair = rectified_pair(seen.camera, right)
    if isinstance(pair, Failure):
        return np.zeros(0)
    far_px, near_px = (
        pair.disparity_at(depth_m) + pair.offset_px for depth_m in (settings.far_m, settings.near_m)
    )
    return row_differences(to_grey(seen.image_bgr), to_grey(right.image_bgr), far_px, near_px, settings)
