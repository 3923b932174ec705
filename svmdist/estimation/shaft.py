"""Markerless, one camera: the shaft's silhouette gives its axis in 3D, rim and knuckle the place along it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.errors import KinematicsError, ProfileError
from svmdist.estimation.distances import measure
from svmdist.estimation.instrument_model import NECK_PER_RADIUS, InstrumentModel
from svmdist.estimation.shaft_fit import ShaftFit, ShaftModel, fit_shaft
from svmdist.estimation.shaft_sight import see_knuckle, see_shaft
from svmdist.estimation.tissue import require_tissue, see_tissue, tissue_row
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain, frame_transforms, select_joints
from svmdist.kinematics.jacobian import joint_axis
from svmdist.profile import Instrument, KinematicError, Profile
from svmdist.samples import Estimate, Image, Observation, Status
from svmdist.transforms import Array, inverse, make_transform
from svmdist.vision.exposure import levelled
from svmdist.vision.segmentation import to_hsv
from svmdist.vision.segmenter import Masks, Segmenter, make_segmenter, own_masks
from svmdist.vision.shaft_segmentation import ShaftRegion, bright_fraction, find_shaft
from svmdist.vision.tag import TagFinder

MAX_STD_M = 0.004
"""A position less certain than this along any direction is no measurement."""
PLATE = 1.45
"""A tag's plate over its black square: the white margin of a cell or more, and the blur around it."""
PRINTED = 0.1
"""Bright part of a dark stub above which it is the print of a tag: half of its cells are white, of a shaft few."""
UNKNOWN_BEND_RAD = 0.4
"""Of the wrist about each axis, where no joints tell."""


class ShaftEstimator:
    """`--method shaft`: one observation in, one estimate out; keeps only whether it saw the tag's plate."""

    name = "shaft"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        rule = profile.segmentation.shaft
        if rule is None or profile.robot is None or profile.instrument is None:
            raise ProfileError(
                f"profile {profile.name} cannot serve the method shaft: it needs [segmentation.shaft], [robot] and"
                " [instrument]"
            )
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._rule = rule
        self._instrument = profile.instrument
        self._chain = chain_of(profile.robot)
        self._model = InstrumentModel.of(profile)
        tag = profile.fiducial
        self._finder = TagFinder(tag.family, tag.id) if tag is not None else None
        self.has_seen_tag = False

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        camera = observation.camera
        # The tissue, on the plane that it lies on.
        sight = see_tissue(self._segmenter.masks(observation.image_bgr), self._profile, camera)
        row = tissue_row(observation.stamp_ns, sight)
        if sight is None or sight.fix is None:
            return row

        # The tool's pose, and the distances from there.
        fit = self.find_tool(observation)
        if isinstance(fit, str):
            return replace(row, status=Status.NO_INSTRUMENT, detail=fit)
        std_m = float(np.sqrt(np.linalg.eigvalsh(fit.pose.position_covariance)[-1]))
        if not std_m <= MAX_STD_M:
            detail = f"the position is uncertain by {std_m * 1e3:.1f} mm"
            return replace(row, status=Status.NO_INSTRUMENT, detail=detail)
        return measure(row, fit.pose, sight.fix, self._model, observation.joints, camera, self.has_seen_tag)

    def find_tool(self, observation: Observation) -> ShaftFit | str:
        """The tool's pose in one frame, or why there is none, in words."""
        # The shaft's contour lines and end, and the coloured knuckle, in the image.
        image_bgr = levelled(observation.image_bgr)
        masks = own_masks(self._segmenter, observation.image_bgr, observation.foreign)
        region = self._find_shaft(image_bgr, masks)
        knuckle = see_knuckle(masks.instrument, self._profile.segmentation.instrument, to_hsv(image_bgr))
        seen = see_shaft(image_bgr, region, knuckle, observation.camera)

        # The pose that fits them, through the wrist.
        model = shaft_model(observation, self._chain, self._instrument, self._profile.kinematic_error)
        return fit_shaft(seen, model, observation.camera)

    def _find_shaft(self, image_bgr: Image, masks: Masks) -> ShaftRegion | None:
        if masks.shaft is None:
            return None
        covered = self._covered(image_bgr)
        region = find_shaft(masks.shaft, self._rule, covered, masks.black)
        if region is None or self._finder is None or covered is not None or not region.is_stub:
            return region
        # The border may cut the plate, whose black print is then as wide as the shaft and ends where it does.
        return None if bright_fraction(region, masks.shaft) > PRINTED else region

    def _covered(self, image_bgr: Image) -> Image | None:
        """Mask of the plate that the profile mounts on the shaft, where the tag on it is found."""
        if self._finder is None:
            return None
        corners_px = self._finder.corners_px(
            np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        )
        if corners_px is None:
            return None
        self.has_seen_tag = True
        return tag_plate(corners_px, image_bgr.shape[:2])


def tag_plate(corners_px: Array, shape: tuple[int, ...]) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + PLATE * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask


def shaft_model(
    observation: Observation, chain: DHChain, instrument: Instrument, error: KinematicError
) -> ShaftModel:
    """What is known before looking: the instrument's sizes, the wrist's bend, and the believed rotation."""
    q = _joints(observation, chain)
    roll = roll_row(chain)
    T_base_shaft, T_shaft_tool = shaft_frames(chain, np.zeros(len(chain.joint_names)) if q is None else q)
    R_believed, rotation_std_rad, bend_std_rad = None, np.pi, UNKNOWN_BEND_RAD
    if q is not None and observation.T_camera_base is not None:
        R_believed = np.asarray((observation.T_camera_base @ T_base_shaft)[:3, :3])
        moving = [row.name for row in chain.rows]
        first = moving.index(error.first_moving_joint) if error.first_moving_joint in moving else 0
        turning = sum(row.joint == "revolute" for row in chain.rows[first : roll + 1])
        rotation_std_rad = float(np.hypot(error.camera_base_std_rad, error.joint_std_rad * np.sqrt(turning)))
        bend_std_rad = error.joint_std_rad
    elif q is not None:
        # How much the wrist is bent is known, but not to which side in the camera frame.
        tool = T_shaft_tool[:3, 3]
        bend_std_rad = max(0.05, float(np.arctan2(np.hypot(tool[0], tool[1]), tool[2])))
        T_shaft_tool = make_transform(np.eye(3), [0.0, 0.0, float(np.linalg.norm(tool))]) @ make_transform(
            T_shaft_tool[:3, :3], np.zeros(3)
        )
    return ShaftModel(
        T_shaft_tool,
        bend_std_rad,
        R_believed,
        rotation_std_rad,
        instrument.shaft_radius_m,
        instrument.shaft_end_m or NECK_PER_RADIUS * instrument.wrist_radius_m,
        instrument.knuckle_radius_m,
    )


def roll_row(chain: DHChain) -> int:
    """The row whose joint turns the shaft about itself: the first revolute one behind the last that slides."""
    slides = [index for index, row in enumerate(chain.rows) if row.joint == "prismatic"]
    turns = [
        index
        for index, row in enumerate(chain.rows)
        if row.joint == "revolute" and index > max(slides, default=-1)
    ]
    if not slides or len(turns) < 2:
        raise ProfileError(
            "the method shaft needs a chain that slides along its shaft, turns it, and has a wrist"
        )
    return turns[0]


def shaft_frames(chain: DHChain, q: Array) -> tuple[Array, Array]:
    """`T_base_shaft` and `T_shaft_tool` at joints `q`, shape (n_joints,).

    The shaft's frame: z along the roll's axis, which is the insertion's, to the tip; its origin is the point of that
    axis next to the wrist's pitch axis.
    """
    frames = frame_transforms(chain, q)
    roll = roll_row(chain)
    z, on_axis_m = joint_axis(chain, frames, roll)
    _, hinge_m = joint_axis(chain, frames, roll + 1)
    x = frames[roll, :3, 0] - z * float(z @ frames[roll, :3, 0])
    x /= np.linalg.norm(x)
    origin_m = on_axis_m + z * float(z @ (hinge_m - on_axis_m))
    T_base_shaft = make_transform(np.stack([x, np.cross(z, x), z], -1), origin_m)
    return T_base_shaft, inverse(T_base_shaft) @ frames[-1] @ chain.T_last_tool


def _joints(observation: Observation, chain: DHChain) -> Array | None:
    if observation.joints is None:
        return None
    try:
        return select_joints(chain, observation.joints.names, observation.joints.positions)
    except KinematicsError:
        return None
