"""Perturbations of what log and profile say of cameras, instrument, tag and plane: said minus true."""

from __future__ import annotations

from svmdist.perturbations.laws import Normal
from svmdist.perturbations.perturbation import Perturbation, Place

ZHANG = "assumed, after Zhang 2000: with the few images and the short focal length of an endoscope"
MADE = "assumed: what a calliper and a maker's drawing leave"


def _stated(
    name: str, unit: str, meaning: str, most: float, std: float, source: str, axes: int = 1
) -> Perturbation:
    return Perturbation(name, unit, Place.CALIBRATION, meaning, -most, most, Normal(std, axes), source)


CALIBRATION = (
    _stated("focal", "%", "Stated focal length, too large by this much.", 20.0, 0.3, ZHANG),
    _stated(
        "principal_point",
        "px",
        "Stated principal point, too far right and too far down by this much each.",
        100.0,
        1.5,
        ZHANG,
    ),
    _stated(
        "baseline", "mm", "Stated distance of the right camera, too large by this much.", 2.0, 0.05, ZHANG
    ),
    _stated(
        "right_yaw",
        "deg",
        "The right camera is turned about its y axis, which is not said.",
        5.0,
        0.03,
        ZHANG,
    ),
    _stated(
        "right_pitch",
        "deg",
        "The right camera is turned about its x axis, which is not said.",
        5.0,
        0.03,
        ZHANG,
    ),
    _stated(
        "right_roll",
        "deg",
        "The right camera is turned about its z axis, which is not said.",
        5.0,
        0.03,
        ZHANG,
    ),
    _stated(
        "plane",
        "mm",
        "Stated distance of the tissue's plane, too large by this much.",
        20.0,
        1.0,
        "assumed: a plane through touched points, or organs that settle",
    ),
    _stated(
        "plane_tilt",
        "deg",
        "Stated normal of the tissue's plane, tilted by this much; the direction is drawn by seed.",
        20.0,
        1.0,
        "assumed: a plane through touched points, or organs that settle",
        axes=2,
    ),
    _stated("shaft_radius", "%", "Stated radius of the shaft, too large by this much.", 30.0, 2.0, MADE),
    _stated("wrist_length", "mm", "Stated length of the wrist, too large by this much.", 3.0, 0.3, MADE),
    _stated("knuckle_radius", "%", "Stated radius of the knuckle, too large by this much.", 30.0, 3.0, MADE),
    _stated("tag_size", "%", "Stated side of the tag, too large by this much.", 30.0, 0.5, MADE),
    _stated(
        "tag_mount",
        "mm",
        "Stated place of the tag, off by this much and turned by 4 deg for each mm; directions are drawn by seed.",
        3.0,
        0.3,
        MADE,
        axes=3,
    ),
    Perturbation(
        "zoom",
        "times",
        Place.CALIBRATION,
        "The image is enlarged about its middle, and the stated calibration does not say so.",
        0.5,
        2.0,
        neutral=1.0,
    ),
)
