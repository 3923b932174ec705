"""What a log says of its cameras, perturbed: said is true, times or plus the strength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.perturbations.chosen import Perturbations
from svmdist.transforms import Array, rotation_of


def stated_camera(camera: Camera, perturbations: Perturbations) -> Camera:
    """A camera as a log says it is; the baseline in its P is that of the pair before."""
    if not perturbations.has("focal", "principal_point"):
        return camera
    scale, shift_px = 1.0 + 1e-2 * perturbations["focal"], perturbations["principal_point"]
    P = camera.P
    if P is not None:
        P = np.column_stack([_intrinsics(P[:, :3], scale, shift_px), P[:, 3] * [scale, scale, 1.0]])
    return replace(camera, K=_intrinsics(camera.K, scale, shift_px), P=P)


def stated_right_camera(camera: Camera, perturbations: Perturbations) -> Camera:
    """The right camera of a pair as a log says it is and stands."""
    stated = stated_camera(camera, perturbations)
    P = stated.P
    if P is not None and P[0, 3] and perturbations.has("baseline"):  # a pair
        P = P.copy()
        P[0, 3] -= P[0, 0] * 1e-3 * perturbations["baseline"]
    return replace(stated, P=P)


def right_turn(perturbations: Perturbations) -> Array:
    """How the right camera is turned against what is said, in its own axes, shape (3, 3).

    A log says that its pair is rectified: it is the pair that is not, and no method would take one of which it is said.
    """
    axes = ("right_pitch", "right_yaw", "right_roll")  # about x, y and z
    return rotation_of(np.deg2rad([perturbations[name] for name in axes]))


def zoomed_camera(camera: Camera, zoom: float) -> Camera:
    """The camera that sees what another one sees, enlarged about the middle of the image."""
    middle = np.array([(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0])
    enlarge = np.array(
        [[zoom, 0.0, (1 - zoom) * middle[0]], [0.0, zoom, (1 - zoom) * middle[1]], [0.0, 0.0, 1.0]]
    )
    return replace(camera, K=enlarge @ camera.K, P=None if camera.P is None else enlarge @ camera.P)


def _intrinsics(K: Array, scale: float, shift_px: float) -> Array:
    changed = K.copy()
    changed[:2, :2] *= scale
    changed[:2, 2] += shift_px
    return changed
