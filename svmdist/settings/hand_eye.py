"""Settings of the hand-eye fit."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class HandEyeSettings(MethodSettings):
    """What the fit of the camera-to-base transform assumes, and when it refuses."""

    min_count: int = Field(default=8, ge=4)
    """Frames in which the seen tool agrees with the robot's: fewer say nothing of each other."""
    min_fraction: float = Field(default=0.5, gt=0.0, le=1.0)
    """Part of the frames that must agree: else what is seen is another thing than what the robot moves."""
    gate: float = Field(default=16.3, gt=0.0)
    """Largest squared normalised residual of a place that agrees: chi square of 3 degrees of freedom, 99.9 %."""
    huber: float = Field(default=2.0, gt=0.0)
    """Normalised residual from which on a frame counts less."""
    trials: int = Field(default=400, ge=10)
    """Samples of three frames that the fit starts from."""
    axis_floor_rad: float = Field(default=0.01, gt=0.0)
    """Standard deviation added to that of a shaft's direction in the image: what its outline does not show, 0.6°."""
    axis_tilt_floor_rad: float = Field(default=0.17, gt=0.0)
    """The same towards the camera, 10°: without joints, edges in shadows tilted it by that in simulated rooms."""
    position_floor_m: float = Field(default=2e-4, gt=0.0)
    """Standard deviation added to that of a place, along each axis."""
    max_turn_std_rad: float = Field(default=0.26, gt=0.0)
    """Largest standard deviation of the rotation, 15°: beyond it the tool has not moved enough."""
    pose_std_m: float = Field(default=1e-3, gt=0.0)
    """Standard deviation of recorded poses along each axis, where no joints are known: cables stretch."""
    correlation_time_s: float = Field(default=0.5, gt=0.0)
    """How long errors of a detection and play of joints last: between two reversals of a joint."""
