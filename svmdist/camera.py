"""The pinhole camera: intrinsics, projection, and the one place where OpenGL axes become OpenCV axes.

Pixel coordinates follow OpenCV: the centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from svmdist.transforms import Array, make_transform, rotation_error

R_OPENGL_OPENCV: Array = np.diag([1.0, -1.0, -1.0])
"""OpenCV axes (x right, y down, z forward) in OpenGL's (x right, y up, z backward); its own inverse."""

MAX_COEFFICIENTS = 14
MAX_COEFFICIENT = 1e5  # of a lens: rational models of endoscopes have some hundreds
MAX_ROTATION_ERROR = 0.01  # of R·Rᵀ: files round
MAX_FOCAL_PX = 1e7  # beyond it an image of 4,000 px is less than a minute of arc wide

DistortionModel = Literal["plumb_bob", "rational_polynomial", "fisheye"]
KNOWN_DISTORTION: dict[str, DistortionModel] = {
    **dict.fromkeys(("", "none", "plumb_bob", "radtan"), "plumb_bob"),
    "rational_polynomial": "rational_polynomial",
    **dict.fromkeys(("equidistant", "fisheye", "kannala_brandt"), "fisheye"),
}  # the distortion model by its name in a log or a calibration file


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with the distortion of its lens, as `foxglove.CameraCalibration` carries it.

    `K` has shape (3, 3) in px; `D` holds OpenCV's k1, k2, p1, p2[, k3…] of the models `plumb_bob` and
    `rational_polynomial`, or k1 to k4 of `fisheye` (Kannala and Brandt 2006); it is empty for none.
    `R_rectified_camera` and `P` (3, 4) are the rectification and projection of a stereo pair.
    """

    width_px: int
    height_px: int
    K: Array
    D: Array = field(default_factory=lambda: np.zeros(0))
    R_rectified_camera: Array | None = None
    P: Array | None = None
    frame_id: str = "camera"
    distortion_model: DistortionModel = "plumb_bob"

    def __post_init__(self) -> None:
        """Complete the distortion to a length that OpenCV knows; ValueError for what no camera has."""
        R, is_fisheye = self.R_rectified_camera, self.distortion_model == "fisheye"
        for name, matrix, shape in (("K", self.K, (3, 3)), ("R", R, (3, 3)), ("P", self.P, (3, 4))):
            if matrix is not None and matrix.shape != shape:
                raise ValueError(f"{name} has shape {matrix.shape}, expected {shape}")
        if R is not None and not rotation_error(R) <= MAX_ROTATION_ERROR:
            raise ValueError(f"R is no rotation: {R.round(4).tolist()}")
        if self.D.ndim != 1 or len(self.D) > MAX_COEFFICIENTS:
            raise ValueError(f"D has shape {self.D.shape}; at most {MAX_COEFFICIENTS} coefficients are known")
        if is_fisheye and self.D[4:].any():
            raise ValueError(f"D has {len(self.D)} coefficients, and fisheye has 4")
        fx, fy = self.K[0, 0], self.K[1, 1]
        if not (0.0 < fx <= MAX_FOCAL_PX and 0.0 < fy <= MAX_FOCAL_PX):
            found = f"fx = {fx}, fy = {fy} px; expected 0 to {MAX_FOCAL_PX:g}"
            raise ValueError(f"the camera is not calibrated: {found}")
        if not (np.abs(self.D) <= MAX_COEFFICIENT).all():
            raise ValueError(f"D has a coefficient beyond ±{MAX_COEFFICIENT:g}")
        if min(self.width_px, self.height_px) < 1:
            raise ValueError(f"the camera is not calibrated: {self.width_px}x{self.height_px} px")
        whole = 4 if is_fisheye else next(size for size in (0, 4, 5, 8, 12, 14) if size >= len(self.D))
        object.__setattr__(self, "D", np.append(self.D, np.zeros(whole))[:whole])

    @property
    def has_distortion(self) -> bool:
        """Whether the lens bends anything."""
        return bool(np.any(self.D)) or self.distortion_model == "fisheye"

    @property
    def pinhole(self) -> Camera:
        """The same camera with an ideal lens."""
        return replace(self, D=np.zeros(0), distortion_model="plumb_bob")

    @classmethod
    def from_horizontal_fov(
        cls, width_px: int, height_px: int, horizontal_fov_rad: float, frame_id: str = "camera"
    ) -> Camera:
        """Make an ideal camera with square pixels whose optical axis meets the middle of the image."""
        focal_px = width_px / 2.0 / np.tan(horizontal_fov_rad / 2.0)
        cx, cy = (width_px - 1) / 2.0, (height_px - 1) / 2.0  # pixel centres are integers
        K = np.array([[focal_px, 0.0, cx], [0.0, focal_px, cy], [0.0, 0.0, 1.0]])
        return cls(width_px, height_px, K, np.zeros(5), np.eye(3), np.hstack([K, np.zeros((3, 1))]), frame_id)

    def project(self, p_camera_m: ArrayLike) -> Array:
        """Project points of the camera frame, shape (n, 3) in m and in front of it, to px, shape (n, 2)."""
        p = np.atleast_2d(np.asarray(p_camera_m, np.float64))
        if not self.has_distortion:
            return np.asarray(p[:, :2] / p[:, 2:] @ self.K[:2, :2].T + self.K[:2, 2])
        import cv2  # of few lenses: a camera is there without OpenCV

        project = cv2.fisheye.projectPoints if self.distortion_model == "fisheye" else cv2.projectPoints
        pixels, _ = project(p[:, None], np.zeros(3), np.zeros(3), self.K, self.D)
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def project_with_derivative(self, p_camera_m: Array) -> tuple[Array, Array]:
        """Pixels, (..., 2), of points, (..., 3) in m, and their derivative, (..., 2, 3); methods see ideal images."""
        z, A = p_camera_m[..., 2:], self.K[:2, :2]
        pixels = p_camera_m[..., :2] / z @ A.T
        slope = np.empty((*pixels.shape, 3))
        np.divide(A, z[..., None], out=slope[..., :2])
        slope[..., 2] = -pixels / z
        return pixels + self.K[:2, 2], slope

    def rays(self, points_px: ArrayLike) -> Array:
        """Directions in the camera frame, shape (n, 3) with z = 1, of pixels, shape (n, 2); without distortion."""
        points = np.asarray(points_px, np.float64).reshape(-1, 2)
        if not self.has_distortion:
            (fx, skew, cx), (_, fy, cy), _ = self.K
            y = (points[:, 1] - cy) / fy
            return np.stack([(points[:, 0] - cx - skew * y) / fx, y, np.ones(len(points))], -1)
        import cv2

        if self.distortion_model == "fisheye":
            straight = cv2.fisheye.undistortPoints(points[:, None], self.K, self.D)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
            straight = cv2.undistortPoints(points[:, None], self.K, self.D, None, None, None, criteria)
        return np.column_stack([np.asarray(straight).reshape(-1, 2), np.ones(len(points))])

    def same_optics(self, other: Camera, tolerance_px: float = 1e-6) -> bool:
        """Whether size, intrinsics and distortion agree within a tolerance in px."""
        D, other_D = (np.pad(one.D, (0, MAX_COEFFICIENTS - len(one.D))) for one in (self, other))
        own, others = ((one.width_px, one.height_px, one.distortion_model == "fisheye") for one in (self, other))
        is_near = np.allclose(self.K, other.K, 0.0, tolerance_px) and np.allclose(D, other_D, 0.0, 1e-9)
        return own == others and bool(is_near)


def stereo_transform(left: Camera, right: Camera) -> Array | None:
    """The right camera's pose in the left one's frame, `T_left_right`, shape (4, 4); None without a baseline.

    As ROS has it: `P[:, 3]` is K' times the position in the rectified frame that both share.
    """
    if right.P is None or not right.P[:2, 3].any():
        return None
    position_m = -right.P[:2, 3] / np.diag(right.P[:2, :2])
    R_left, R_right = (np.eye(3) if R is None else R for R in (left.R_rectified_camera, right.R_rectified_camera))
    return make_transform(R_left.T @ R_right, R_left.T @ [*position_m, 0.0])


def are_exchanged(left: Camera, right: Camera) -> bool:
    """Whether the left one's own matrix has it at the right of the other one, which has no baseline."""
    found = stereo_transform(right, left) if stereo_transform(left, right) is None else None
    return found is not None and bool(found[0, 3] > 0.0)
