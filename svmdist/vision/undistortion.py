"""Images as an ideal pair of cameras would see them: without the lens's distortion, both views parallel.

Detectors and estimators assume a pinhole. An image of any other lens is mapped once, with its camera's own K, so that
the pixels near the principal point stay where they are; what a lens shows beyond the image's frame is lost.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from svmdist.camera import Camera, fisheye_coefficients
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import Array, make_transform


def as_pinholes(observation: Observation, row_offset_px: float = 0.0) -> Observation:
    """The observation with both views as ideal cameras give them; the same object where they are already.

    `row_offset_px` is by how much rows of the right view lie below those of the left one after that; it is removed.
    """
    left, right = observation.camera, observation.right
    if left.has_distortion:
        image = _mapped(observation.image_bgr, left, np.eye(3), left)
        observation = replace(observation, image_bgr=image, camera=left.pinhole)
    if right is None:
        return observation
    if not _is_rectified(left, right):
        right = _beside(left, right)
        observation = replace(observation, right=right)
    if row_offset_px == 0.0:
        return observation
    raised = _raised(right.image_bgr, row_offset_px)
    return replace(observation, right=replace(right, image_bgr=raised))


def _raised(image: Image, rows_px: float) -> Image:
    """An image moved up by a number of rows, not a whole one in general."""
    height, width = image.shape[:2]
    moved = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -rows_px]])
    return np.asarray(
        cv2.warpAffine(image, moved, (width, height), None, cv2.INTER_CUBIC, cv2.BORDER_CONSTANT), np.uint8
    )


def seen_through(camera: Camera, pinhole_px: Array) -> Array:
    """Where the lens shows what stands at pixels of the pinhole's image, shape (n, 2), in px."""
    if not camera.has_distortion:
        return pinhole_px
    xy = (pinhole_px - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    return camera.project(np.column_stack([xy, np.ones(len(xy))]))


def _is_rectified(left: Camera, right: RightView) -> bool:
    """Whether rows of both views correspond as they are."""
    same_K = np.allclose(np.delete(left.K - right.camera.K, 2, axis=1), 0.0, atol=1e-3)
    return (
        not left.has_distortion
        and not right.camera.has_distortion
        and bool(same_K)
        and abs(left.K[1, 2] - right.camera.K[1, 2]) <= 1e-3
        and np.allclose(right.T_left_right[:3, :3], np.eye(3), atol=1e-6)
    )


def _beside(left: Camera, right: RightView) -> RightView:
    """The right view turned parallel to the left one, with the left one's K."""
    R_left_right, place_m = right.T_left_right[:3, :3], right.T_left_right[:3, 3]
    ideal = replace(left.pinhole, frame_id=right.camera.frame_id, P=None, R_rectified_camera=None)
    image = _mapped(right.image_bgr, right.camera, R_left_right, ideal)
    return replace(right, image_bgr=image, camera=ideal, T_left_right=make_transform(np.eye(3), place_m))


def _mapped(image: Image, camera: Camera, R_ideal_camera: Array, ideal: Camera) -> Image:
    across, down = _maps(
        camera.K.tobytes(),
        camera.D.tobytes(),
        camera.distortion_model,
        R_ideal_camera.tobytes(),
        ideal.K.tobytes(),
        (ideal.width_px, ideal.height_px),
    )
    return np.asarray(cv2.remap(image, across, down, cv2.INTER_LINEAR), np.uint8)


@lru_cache(maxsize=8)
def _maps(
    K: bytes, D: bytes, model: str, R_ideal_camera: bytes, K_ideal: bytes, size_px: tuple[int, int]
) -> tuple[Array, Array]:
    """Where each pixel of an ideal camera is in the image, as fixed-point maps; computed once for a camera."""
    K_from, R, K_to = (np.frombuffer(data).reshape(3, 3) for data in (K, R_ideal_camera, K_ideal))
    coefficients = np.frombuffer(D)
    if model == "fisheye":
        maps = cv2.fisheye.initUndistortRectifyMap(
            K_from, fisheye_coefficients(coefficients), R, K_to, size_px, cv2.CV_16SC2
        )
    else:
        maps = cv2.initUndistortRectifyMap(K_from, coefficients, R, K_to, size_px, cv2.CV_16SC2)
    return np.asarray(maps[0]), np.asarray(maps[1])
