"""The methods: one table of what makes each, what it needs of log and profile, what it draws and what it measures."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, Protocol, cast

from svmdist.errors import UsageError, did_you_mean
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.plane_mapping import PlaneMapping
from svmdist.estimation.scene import Arm
from svmdist.results import FrameResult


class Estimator(Protocol):
    """What every method is.

    Its name; the detections that it always asks for, so that they may be computed ahead; and whether a result depends
    on earlier frames: without state, frames may be measured in any order.
    """

    name: str
    needs: Needs
    keeps_state: bool

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame. A frame that cannot be measured is an outcome, not an exception."""


Topic = Literal["camera_to_base", "joints", "right_image", "robot"]
Input = Topic | Literal["calibration", "fiducial", "instrument", "shaft", "tag", "tissue"]
"""What a method may need besides left images: topics of the log, tables of the profile, and the tag in the images."""
PaperPhase = Literal["segmentation", "contours", "marker", "matches", "outline and distance"]
Phase = PaperPhase | Literal["edges and tip", "tip", "tag", "surface", "distance", "side view"]
"""A picture of one step of a method."""


@dataclass(frozen=True)
class Method:
    """One method; `estimator` is the class, by its path in this package, imported when it is made."""

    name: str
    estimator: str
    inputs: tuple[Input, ...]
    draws: tuple[Phase, ...]
    is_planar: bool = False  # in the paper's plane only: it needs the mapping from pixels to it


_TABLE = (
    Method(
        "overlay",
        "planar.OverlayEstimator",
        ("calibration",),
        ("segmentation", "contours", "marker", "matches", "outline and distance"),
        is_planar=True,
    ),
    Method(
        "centroid",
        "planar.CentroidEstimator",
        ("calibration",),
        ("segmentation", "contours", "distance"),
        is_planar=True,
    ),
    Method(
        "fiducial",
        "frame_methods.FiducialEstimator",
        ("joints", "fiducial", "tissue", "tag"),
        ("segmentation", "tag", "distance", "side view"),
    ),
    Method(
        "shaft",
        "frame_methods.ShaftEstimator",
        ("shaft", "instrument", "robot", "tissue"),
        ("segmentation", "edges and tip", "distance", "side view"),
    ),
    Method(
        "stereo",
        "frame_methods.StereoEstimator",
        ("right_image", "robot", "tissue"),
        ("segmentation", "tip", "surface", "distance", "side view"),
    ),
    Method(
        "kinematic",
        "frame_methods.KinematicEstimator",
        ("joints", "camera_to_base", "tissue"),
        ("segmentation", "distance", "side view"),
    ),
    Method(
        "fused",
        "fused.FusedEstimator",
        ("joints", "camera_to_base", "tissue"),
        ("segmentation", "edges and tip", "tag", "surface", "distance", "side view"),
    ),
)

REGISTRY = {method.name: method for method in _TABLE}
METHODS = tuple(REGISTRY)
PLANAR_METHODS = tuple(method.name for method in _TABLE if method.is_planar)
SPATIAL_METHODS = tuple(method.name for method in _TABLE if not method.is_planar)


def make_estimator(name: str, arm: Arm, mapping: PlaneMapping | None = None) -> Estimator:
    """Make the estimator of that name; raises UsageError for an unknown name, or a planar one without mapping."""
    if name not in REGISTRY:
        raise UsageError(f"no method {name}: {did_you_mean(name, METHODS)}")
    method = REGISTRY[name]
    if method.is_planar and mapping is None:
        raise UsageError(f"method {name} is planar: it needs a calibration")
    module, _, kind = method.estimator.rpartition(".")
    make: Any = getattr(import_module(f"svmdist.estimation.{module}"), kind)
    return cast("Estimator", make(arm, mapping) if method.is_planar else make(arm))
