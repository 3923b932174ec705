"""One image in every form that detectors ask for: deinterlaced, rectified, then computed when first asked for."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.profile import Profile
from svmdist.profile.segmentation import AutoSegmentation, HsvSegmentation, OnnxSegmentation, Segmentation
from svmdist.profile.settings import AutoSettings, InterlaceSettings
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import Array, make_transform
from svmdist.vision.colour import Masks, masks_by_colours, normalised, to_grey, to_hsv
from svmdist.vision.instruments.find_instruments import auto_masks
from svmdist.vision.network import OnnxSegmenter
from svmdist.vision.stereo import LEVEL, RowAlignment
from svmdist.vision.tags import find_tags, tag_plate

COMB_RATIO = 3.0  # combed pixels over those that differ from the same field's rows: fine texture does both
BLOCK_PX = 9  # side of the blocks in which these are counted, at 640 columns: smaller than an instrument's tip
MIN_FRACTION = 0.12  # of a block's pixels that are combed, where its odd rows are mended
MIN_PIXELS = 60  # combed pixels in a whole image, at 640 columns, below which nothing is looked at further
COMBED_COLOURS = 0.07  # of combed pixels: 0.1 or more where colours are their field's own, 0.05 at most where mixed

DEFAULT = InterlaceSettings()
USUAL_FAMILY = "36h11"  # of tags: AprilTag's own default
COLUMNS = 640  # sizes in px are for images of so many columns
REACH = 3  # blocks about a combed one that are mended with it: part of what moves has too little contrast


def with_first_fields(observation: Observation, settings: InterlaceSettings = DEFAULT) -> Observation:
    """The observation with both views at the instant of their first field; the same images where nothing is combed."""
    right = observation.right
    if right is not None:
        right = replace(right, image_bgr=first_field(right.image_bgr, settings))
    return replace(observation, image_bgr=first_field(observation.image_bgr, settings), right=right)


def first_field(bgr: Image, settings: InterlaceSettings = DEFAULT) -> Image:
    """The image, shape (h, w, 3), with the odd rows of combed places made of the even ones; the same array without."""
    scale = bgr.shape[1] / COLUMNS
    green = np.asarray(cv2.extractChannel(bgr, 1), np.uint8)
    combed = _stands_out(green, 1, settings.comb_levels)
    if cv2.countNonZero(combed) < MIN_PIXELS * scale**2:
        return bgr
    textured = _stands_out(green, 2, settings.comb_levels)
    side = 2 * round(0.5 * BLOCK_PX * scale) + 1
    comb, texture = (cv2.boxFilter(mask, cv2.CV_32F, (side, side)) for mask in (combed, textured))
    is_combed = (comb > MIN_FRACTION) & (comb > COMB_RATIO * texture)
    if np.count_nonzero(is_combed) < MIN_PIXELS * scale**2:
        return bgr
    places = cv2.dilate(is_combed.astype(np.uint8), np.ones((REACH * side, REACH * side), np.uint8))
    mended = bgr.copy()
    between = cv2.addWeighted(bgr[0:-2:2], 0.5, bgr[2::2], 0.5, 0.0)
    np.copyto(mended[1:-1:2], between, where=places[1:-1:2, :, None] > 0)
    return mended


def mixes_colours(bgr: Image, settings: InterlaceSettings = DEFAULT) -> bool:
    """Whether a combed image, shape (h, w, 3), has the mean of both fields' colours, as 4:2:0 has: only light combs."""
    green, red = (np.asarray(cv2.extractChannel(bgr, at), np.uint8) for at in (1, 2))
    combed = _stands_out(green, 1, settings.comb_levels)
    colour = np.asarray(cv2.addWeighted(red, 0.5, green, -0.5, 128.0), np.uint8)
    coloured = combed & _stands_out(colour, 1, 0.5 * settings.comb_levels)
    return cv2.countNonZero(coloured) < COMBED_COLOURS * cv2.countNonZero(combed)


def _stands_out(levels_of: Image, away: int, levels: float) -> Image:
    """Mask of ones, shape (h, w): pixels brighter, or darker, than both those so many rows above and below."""
    mask = np.zeros(levels_of.shape, np.uint8)
    if len(mask) <= 2 * away:
        return mask
    middle, above, below = levels_of[away:-away], levels_of[: -2 * away], levels_of[2 * away :]
    brighter = cv2.subtract(middle, cv2.max(above, below))
    darker = cv2.subtract(cv2.min(above, below), middle)
    _, mask[away:-away] = cv2.threshold(cv2.max(brighter, darker), levels, 1.0, cv2.THRESH_BINARY)
    return mask


def as_pinholes(observation: Observation, rows: RowAlignment = LEVEL) -> Observation:
    """Both views as ideal cameras give them, the right one's rows aligned; the same images where they are."""
    left, right = observation.camera, observation.right
    if left.has_distortion:
        image = _mapped(observation.image_bgr, left, np.eye(3), left)
        observation = replace(observation, image_bgr=image, camera=left.pinhole)
    if right is None:
        return observation
    # Rectified views are ideal, parallel, of one size and, but for the columns of their principal points, alike.
    off = left.K - right.camera.K
    off[0, 2] = 0.0
    is_ideal = not (left.has_distortion or right.camera.has_distortion)
    is_parallel = np.allclose(right.T_left_right[:3, :3], np.eye(3), atol=1e-6)
    of_one_size = (left.width_px, left.height_px) == (right.camera.width_px, right.camera.height_px)
    if not (is_ideal and is_parallel and of_one_size and np.abs(off).max() <= 1e-3):
        right = _beside(left, right)
    if rows != LEVEL:
        size, how = right.image_bgr.shape[1::-1], cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        aligned = cv2.warpAffine(right.image_bgr, rows.of_image(right.camera.K), size, flags=how)
        right = replace(right, image_bgr=np.asarray(aligned, np.uint8))
    return replace(observation, right=right)


def seen_through(camera: Camera, pinhole_px: Array) -> Array:
    """Where the lens shows what stands at pixels of the pinhole's image, shape (n, 2), in px."""
    return camera.project(camera.pinhole.rays(pinhole_px)) if camera.has_distortion else pinhole_px


def _beside(left: Camera, right: RightView) -> RightView:
    """The right view turned parallel to the left one, with the left one's K, moved along the rows to show the same."""
    R_left_right, place_m = right.T_left_right[:3, :3], right.T_left_right[:3, 3]
    middle = np.array([0.5 * (right.camera.width_px - 1), 0.5 * (right.camera.height_px - 1), 1.0])
    seen = left.K @ R_left_right @ np.linalg.solve(right.camera.K, middle)
    K = left.K.copy()
    K[0, 2] += round(0.5 * (left.width_px - 1) - float(seen[0] / seen[2]))
    ideal = replace(left.pinhole, frame_id=right.camera.frame_id, P=None, R_rectified_camera=None, K=K)
    image = _mapped(right.image_bgr, right.camera, R_left_right, ideal)
    return replace(right, image_bgr=image, camera=ideal, T_left_right=make_transform(np.eye(3), place_m))


def _mapped(image: Image, camera: Camera, R_ideal_camera: Array, ideal: Camera) -> Image:
    matrices = (one.tobytes() for one in (camera.K, camera.D, R_ideal_camera, ideal.K))
    maps = _maps(*matrices, camera.distortion_model, (ideal.width_px, ideal.height_px))
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)


@lru_cache(maxsize=8)
def _maps(
    K: bytes, D: bytes, R_ideal_camera: bytes, K_ideal: bytes, model: str, size_px: tuple[int, int]
) -> tuple[Array, Array]:
    """Where each pixel of an ideal camera is in the image, as fixed-point maps; computed once for a camera."""
    K_from, R, K_to = (np.frombuffer(data).reshape(3, 3) for data in (K, R_ideal_camera, K_ideal))
    map_of = cv2.fisheye.initUndistortRectifyMap if model == "fisheye" else cv2.initUndistortRectifyMap
    maps = map_of(K_from, np.frombuffer(D), R, K_to, size_px, cv2.CV_16SC2)
    return np.asarray(maps[0]), np.asarray(maps[1])


Segmenter = HsvSegmentation | OnnxSegmenter | AutoSettings
"""What segments images: boxes of colours, a network that is loaded once, or the settings of `auto`."""


def make_segmenter(rules: Segmentation, auto: AutoSettings | None = None) -> Segmenter:
    """Make the segmenter that a profile asks for; raises ProfileError where its network cannot be used."""
    if isinstance(rules, OnnxSegmentation):
        return OnnxSegmenter(rules)
    return (auto or AutoSettings()) if isinstance(rules, AutoSegmentation) else rules


class FrameContext:
    """One camera image, shape (h, w, 3) in BGR, and what is derived from it.

    Forms without a suffix are at normalised exposure; `_as_recorded` ones are of the image as it is, which the
    paper's methods segment. Nothing that it keeps refers back to it: its images are freed with its last user.
    """

    def __init__(self, bgr: Image, segmenter: Segmenter, profile: Profile) -> None:
        self.bgr_as_recorded, self._segmenter, self._settings = bgr, segmenter, profile.settings
        self._tag_family = None if profile.fiducial is None else profile.fiducial.family

    @cached_property
    def bgr(self) -> Image:
        """The image at normalised exposure; the same array where it is well exposed already."""
        return normalised(self.bgr_as_recorded, self._settings.exposure)

    @cached_property
    def hsv_as_recorded(self) -> Image:
        """OpenCV's 8-bit HSV, shape (h, w, 3)."""
        return to_hsv(self.bgr_as_recorded)

    @cached_property
    def hsv(self) -> Image:
        """OpenCV's 8-bit HSV at normalised exposure."""
        return self.hsv_as_recorded if self.bgr is self.bgr_as_recorded else to_hsv(self.bgr)

    @cached_property
    def grey(self) -> Image:
        """Grey levels of the image as it is, shape (h, w): features and tags need no exposure."""
        return to_grey(self.bgr_as_recorded)

    @cached_property
    def tags(self) -> dict[int, Array]:
        """Corners, shape (4, 2) in px, of every tag of the family, by number; none where no family is given."""
        return find_tags(self.grey, self._tag_family, self._settings.tag) if self._tag_family else {}

    @cached_property
    def masks(self) -> Masks:
        """What is what in the image: colours at normalised exposure, all else as `masks_as_recorded`."""
        if isinstance(self._segmenter, HsvSegmentation) and self.bgr is not self.bgr_as_recorded:
            return masks_by_colours(self._segmenter, self.hsv)
        return self.masks_as_recorded

    @cached_property
    def masks_as_recorded(self) -> Masks:
        """What is what in the image as it is, which is also what a network was trained on."""
        segmenter = self._segmenter
        if isinstance(segmenter, HsvSegmentation):
            return masks_by_colours(segmenter, self.hsv_as_recorded)
        if isinstance(segmenter, OnnxSegmenter):
            return segmenter.masks(self.bgr_as_recorded)
        return auto_masks(self.bgr_as_recorded, segmenter, self.plates)

    @cached_property
    def plates(self) -> Image | None:
        """Where plates of tags are, shape (h, w); None where no tag is seen, of the profile's family or the usual one.

        A tag on an instrument may be missing in the profile: it is as wide as the shaft, and none of its parts.
        """
        tags = self.tags if self._tag_family else find_tags(self.grey, USUAL_FAMILY, self._settings.tag)
        plates = [tag_plate(one, self.grey.shape, self._settings.tag) for one in tags.values()]
        return np.asarray(np.bitwise_or.reduce(plates)) if plates else None
