"""Perturbations of what a robot reports: its joints, and the clock that stamps them."""

from __future__ import annotations

from svmdist.perturbations.laws import Always, Normal, Uniform
from svmdist.perturbations.perturbation import Perturbation, Place

CABLES = "Hwang et al. 2020; Peng et al. 2024: 0.4° to 0.5° and 0.5 mm in cable-driven joints behind a constant offset"
SLACK = "assumed; Haghighipanah et al. 2015, Richter et al. 2021: errors of cables change with load and time"

JOINTS = (
    Perturbation(
        "backlash",
        "deg",
        Place.JOINTS,
        "The joint trails what is reported by up to this much, on the side that it comes from (hysteresis).",
        0.0,
        10.0,
        Uniform(0.3, 0.5),
        CABLES,
    ),
    Perturbation(
        "joint_drift",
        "deg in 8 s",
        Place.JOINTS,
        "Reported joints wander slowly and smoothly: standard deviation of the change over 8 s.",
        0.0,
        10.0,
        Always(0.2),
        SLACK,
    ),
    Perturbation(
        "joint_noise",
        "deg",
        Place.JOINTS,
        "Standard deviation of every reported sample.",
        0.0,
        5.0,
        Always(0.02),
        "assumed: vibration, and play of a joint that is driven",
    ),
    Perturbation(
        "quantisation",
        "deg",
        Place.JOINTS,
        "Joints are reported in steps of this size.",
        0.0,
        5.0,
        Always(0.02),
        "assumed, coarse: encoders are on the motors (Kazanzides et al. 2014), but logs may be rounded",
    ),
)

CLOCK = (
    Perturbation(
        "lag",
        "ms",
        Place.CLOCK,
        "Joints are late against the images: their stamps lie this much behind the motion.",
        -200.0,
        200.0,
        Normal(20.0, limit=60.0),
        "assumed: one period of a 50 to 60 Hz frame grabber, which stamps an image when it arrives",
    ),
    Perturbation(
        "lag_drift",
        "ms/s",
        Place.CLOCK,
        "The lag grows by this much every second.",
        -10.0,
        10.0,
        Normal(0.05),
        "assumed: quartz clocks without synchronisation, 50 parts in a million",
    ),
)
