"""A method with all that it needs around it: one observation in, one flat row out."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from svmdist.estimation.frame import Arm, Frame, Scene
from svmdist.estimation.methods import make_estimator
from svmdist.estimation.plane_mapping import PlaneMapping
from svmdist.profile import Profile
from svmdist.results import FrameResult, as_vector
from svmdist.samples import Observation
from svmdist.vision.frame_context import Segmenter, make_segmenter


def frame_of(observation: Observation, arm: Arm, segmenter: Segmenter) -> Frame:
    """The frame of the only instrument of an observation."""
    scene = Scene(observation, arm.profile, segmenter)
    return Frame.of(scene, arm, observation)


def shifted(observation: Observation, *shift_m: float) -> Observation:
    """With another transform from camera to base."""
    T = observation.T_camera_base.copy()
    T[:3, 3] += shift_m
    return replace(observation, T_camera_base=T)


class Measuring:
    """An estimator of a profile's only instrument, with a segmenter."""

    def __init__(self, method: str, profile: Profile, mapping: PlaneMapping | None = None) -> None:
        self.arm = Arm(profile)
        self.segmenter = make_segmenter(profile.segmentation)
        self.estimator = make_estimator(method, self.arm, mapping)

    def result(self, observation: Observation) -> FrameResult:
        return self.estimator.estimate(frame_of(observation, self.arm, self.segmenter))

    def estimate(self, observation: Observation) -> Any:
        return flat(self.result(observation))


def flat(result: FrameResult) -> Any:
    """A result with its numbers side by side, named as the columns of `svmdist estimate` are."""
    image, distances = result.image, result.distances
    row: dict[str, Any] = {
        "stamp_ns": result.stamp_ns,
        "status": result.status,
        "detail": result.detail,
        "measured": result.measured,
        "instrument": result.instrument,
        "tool_area_px": image.tool_area_px,
        "tissue_area_px": image.tissue_area_px,
        "keypoint_count": image.keypoint_count,
        "match_count": image.match_count,
        "inlier_count": image.inlier_count,
    }
    row["tool_x_px"], row["tool_y_px"] = image.tool_px or (None, None)
    row["tissue_x_px"], row["tissue_y_px"] = image.tissue_px or (None, None)
    for name, distance in (
        ("distance", distances.planar),
        ("spatial", distances.spatial),
        ("clearance", distances.clearance),
        ("instrument_clearance", distances.to_instrument),
    ):
        row[f"{name}_m"] = distance.value_m if distance else None
        row[f"{name}_std_m"] = distance.std_m if distance else None
        row[f"{name}_direction"] = distance.direction if distance else None
    tool = result.tool if result.measured else None
    row["tool_position_m"] = as_vector(tool.pose.position_m) if tool else None
    row["tool_axis"] = as_vector(tool.pose.axis) if tool else None
    return SimpleNamespace(**row)
