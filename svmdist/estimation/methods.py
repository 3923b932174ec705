"""The methods: one table of what makes each, what it needs of log and profile, what it draws and what it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from operator import attrgetter
from typing import Any, Literal

from svmdist.errors import ProfileError, UsageError, did_you_mean
from svmdist.estimation.frame import Arm, Frame, Needs
from svmdist.estimation.plane_mapping import PlaneMapping
from svmdist.estimation.tissue.detection import require_tissue
from svmdist.results import FrameResult

Topic = Literal["camera_to_base", "joints", "right_image", "robot"]
Input = Topic | Literal["calibration", "fiducial", "instrument", "shaft", "tag", "tissue"]
"""What a method may need besides left images: topics of the log, tables of the profile, and the tag in the images."""
PaperPhase = Literal["segmentation", "contours", "marker", "matches", "outline and distance"]
Phase = PaperPhase | Literal["edges and tip", "tip", "tag", "surface", "distance", "side view"]
"""A picture of one step of a method."""
TABLES = {"joints": "robot", "shaft": "segmentation.shaft"}
TABLES |= {name: name for name in ("robot", "instrument", "fiducial")}
"""The profile's table behind an input; what a log lacks is an outcome of its frames."""


@dataclass(frozen=True)
class Method:
    """One method, by the path of what measures in this package, which is imported when an estimator is made."""

    measures: str  # a function of a frame
    inputs: tuple[Input, ...]
    draws: tuple[Phase, ...]
    needs: Needs  # the detections that it always asks for, so that they may be computed ahead
    is_planar: bool = False  # it takes the mapping from pixels to the paper's plane, too
    keeps_state: bool = False  # results depend on earlier frames: it is a class, made for an arm


OF_BOTH = ("left.distal_marker", "right.distal_marker", "left.shaft", "right.shaft")
REGISTRY: dict[str, Method] = {
    "overlay": Method(
        "planar.by_overlay",
        ("calibration",),
        ("segmentation", "contours", "marker", "matches", "outline and distance"),
        Needs(frame=("left.regions_as_recorded",), robot=False),
        is_planar=True,
    ),
    "centroid": Method(
        "planar.by_centroid",
        ("calibration",),
        ("segmentation", "contours", "distance"),
        Needs(frame=("left.regions_as_recorded",), robot=False),
        is_planar=True,
    ),
    "fiducial": Method(
        "frame_methods.by_tag",
        ("joints", "fiducial", "tissue", "tag"),
        ("segmentation", "tag", "distance", "side view"),
        Needs(("tissue", "left.tags"), ("tag",)),
    ),
    "shaft": Method(
        "frame_methods.by_shaft",
        ("shaft", "instrument", "robot", "tissue"),
        ("segmentation", "edges and tip", "distance", "side view"),
        Needs(("tissue", "left.tags"), ("shaft_pose",)),
    ),
    "stereo": Method(
        "frame_methods.by_both_views",
        ("right_image", "robot", "tissue"),
        ("segmentation", "tip", "surface", "distance", "side view"),
        Needs(("tissue", "stereo_surface", "left.tags"), OF_BOTH, right_view=True),
    ),
    "kinematic": Method(
        "frame_methods.KinematicEstimator",
        ("joints", "camera_to_base", "tissue"),
        ("segmentation", "distance", "side view"),
        Needs(("tissue",)),
        keeps_state=True,
    ),
    "fused": Method(
        "fused.FusedEstimator",
        ("joints", "camera_to_base", "tissue"),
        ("segmentation", "edges and tip", "tag", "surface", "distance", "side view"),
        Needs(("tissue", "left.tags", "stereo_surface"), OF_BOTH[:3], right_view=True),
        keeps_state=True,
    ),
}
METHODS = tuple(REGISTRY)
PLANAR_METHODS = tuple(name for name, method in REGISTRY.items() if method.is_planar)
SPATIAL_METHODS = tuple(name for name, method in REGISTRY.items() if not method.is_planar)


@dataclass
class Estimator:
    """What measures frames by one method; a frame that cannot be measured is an outcome, not an exception."""

    needs: Needs
    keeps_state: bool
    estimate: Callable[[Frame], FrameResult]


def make_estimator(name: str, arm: Arm, mapping: PlaneMapping | None = None) -> Estimator:
    """Make an estimator; UsageError for an unknown name, a planar one without mapping; ProfileError for what lacks."""
    if name not in REGISTRY:
        raise UsageError(f"no method {name}: {did_you_mean(name, METHODS)}")
    method = REGISTRY[name]
    if method.is_planar and mapping is None:
        raise UsageError(f"method {name} is planar: it needs a calibration")
    profile, tables = arm.profile, [TABLES[one] for one in method.inputs if one in TABLES]
    if lacks := [f"[{table}]" for table in tables if attrgetter(table)(profile) is None]:
        raise ProfileError(f"profile {profile.name} has no {', no '.join(lacks)}: {name} measures by it")
    if "tissue" in method.inputs:
        require_tissue(profile)
    module, _, kind = method.measures.rpartition(".")
    measures: Any = getattr(import_module(f"svmdist.estimation.{module}"), kind)
    if method.keeps_state:
        measures = measures(arm).estimate
    elif method.is_planar:
        measures = partial(measures, mapping=mapping)
    return Estimator(method.needs, method.keeps_state, measures)
