"""Where an instrument's region will be in the next image: by the nominal motion, or at constant velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array

DEFAULT = AssociationSettings()


@dataclass(frozen=True, slots=True)
class Gaussian:
    """A place in the image: mean, shape (2,) in px, and covariance, shape (2, 2) in px²."""

    mean: Array
    covariance: Array

    @property
    def std_px(self) -> float:
        """Along the direction in which it is least sure."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))


class SteadyMotion:
    """Constant velocity with random accelerations: a Kalman filter over (x, y, vx, vy) in px and px/s."""

    def __init__(self, width_px: int, settings: AssociationSettings = DEFAULT) -> None:
        self._acceleration = settings.acceleration_widths * width_px
        self._first_speed = settings.first_speed_widths * width_px
        self._x: Array | None = None
        self._P = np.zeros((4, 4))
        self._stamp_ns = 0
        self._now_ns = 0

    def predict(self, stamp_ns: int) -> Gaussian | None:
        """Go on to a stamp; None before the first region."""
        self._now_ns = stamp_ns
        if self._x is None:
            return None
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.vstack([0.5 * dt * dt * np.eye(2), dt * np.eye(2)])
        self._x = F @ self._x
        self._P = F @ self._P @ F.T + self._acceleration**2 * G @ G.T
        self._stamp_ns = stamp_ns
        return Gaussian(self._x[:2], self._P[:2, :2])

    def update(self, pixel: Array, std_px: float) -> None:
        """Take up a region, shape (2,)."""
        self._update(np.asarray(pixel, np.float64), std_px**2 * np.eye(2))

    def follow(self, place: Gaussian) -> None:
        """Take up a place that another prediction gives, for it knows better."""
        self._update(place.mean, place.covariance)

    def _update(self, pixel: Array, R: Array) -> None:
        if self._x is None:
            self._x = np.array([*pixel, 0.0, 0.0])
            self._P = np.zeros((4, 4))
            self._P[:2, :2], self._P[2:, 2:] = R, self._first_speed**2 * np.eye(2)
            self._stamp_ns = self._now_ns
            return
        H = np.eye(2, 4)
        self._x, self._P = _corrected(self._x, self._P, H, pixel - H @ self._x, R)


@dataclass(frozen=True, slots=True)
class NominalPlace:
    """Where the tool is by nominal kinematics: in the image, and in the camera frame, shape (3,) in m.

    `px_per_m` is how large a metre is seen there.
    """

    place: Gaussian
    position_m: Array
    px_per_m: float


class NominalMotion:
    """The nominal place, corrected: seen = nominal + offset + M (motion in space since it was last seen).

    A robot that is wrong about where its camera stands still knows its own motion. What it gets wrong about how
    that looks, by a wrong depth, place and turn, is linear to first order: offset (2,) and M (2, 3), in px of image
    for px of motion, are the eight states of a Kalman filter. The relation outlives occlusions.
    """

    def __init__(self, width_px: int, settings: AssociationSettings = DEFAULT) -> None:
        self._drift = settings.drift_widths * width_px
        self._settings = settings
        self._x = np.zeros(8)
        self._P: Array | None = None
        self._origin: NominalPlace | None = None
        self._now: NominalPlace | None = None
        self._stamp_ns = 0

    @property
    def has_update(self) -> bool:
        """Whether a region was ever seen, so that the prediction is more than nominal kinematics."""
        return self._P is not None

    def predict(self, stamp_ns: int, nominal: NominalPlace | None) -> Gaussian | None:
        """Where the region should be, for a nominal place; before the first region, the nominal place itself."""
        self._now = nominal
        if nominal is None:
            return None
        if self._P is None:
            self._stamp_ns = stamp_ns
            return nominal.place
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        self._stamp_ns = stamp_ns
        self._P = self._P + dt * np.diag([self._drift**2] * 2 + [self._settings.linear_drift**2] * 6)
        H = self._H(nominal)
        return Gaussian(nominal.place.mean + H @ self._x, H @ self._P @ H.T)

    def update(self, pixel: Array, std_px: float) -> None:
        """Take up a region, shape (2,), seen when the nominal place was the one last given."""
        if self._now is None:
            return
        offset, R = pixel - self._now.place.mean, std_px**2 * np.eye(2)
        if self._P is None:
            self._origin = self._now
            self._x = np.concatenate([offset, np.zeros(6)])
            self._P = np.diag([std_px**2] * 2 + [self._settings.linear_std**2] * 6)
            return
        # From here on motion counts from this place: what is unsure of M shows in what comes, not in what was.
        moved = np.eye(8)
        moved[:2] = self._H(self._now)
        self._x, self._P, self._origin = moved @ self._x, moved @ self._P @ moved.T, self._now
        H = np.eye(2, 8)
        self._x, self._P = _corrected(self._x, self._P, H, offset - H @ self._x, R)

    def _H(self, nominal: NominalPlace) -> Array:
        origin = self._origin or nominal
        motion_px = (nominal.position_m - origin.position_m) * origin.px_per_m
        return np.hstack([np.eye(2), np.kron(np.eye(2), motion_px[None])])


def _corrected(x: Array, P: Array, H: Array, innovation: Array, R: Array) -> tuple[Array, Array]:
    """The Kalman update in Joseph's form, which keeps P positive."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(len(x)) - K @ H
    return x + K @ innovation, A @ P @ A.T + K @ R @ K.T
