"""What a profile says of instrument, tag and plane against what is there, one from the other in both directions."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from svmdist.errors import UsageError
from svmdist.perturbations.chosen import Perturbations, direction
from svmdist.profile import Fiducial, Instrument, Profile, Robot, Tissue
from svmdist.profile.toml import StrictModel
from svmdist.transforms import Array, rotation_of

TURN_DEG_PER_MM = 4.0
"""How far a tag is turned that is glued on a millimetre beside its place: a plate of 9 mm that lies on one edge."""

Model = TypeVar("Model", bound=StrictModel)


def stated_profile(profile: Profile, perturbations: Perturbations, seed: int) -> Profile:
    """What is said of a world that is what the profile says now."""
    return _changed(profile, perturbations, seed, 1)


def built_profile(profile: Profile, perturbations: Perturbations, seed: int) -> Profile:
    """The world of which the profile is said: `stated_profile` of it is the profile again."""
    built = _changed(profile, perturbations, seed, -1)
    if built.simulation is None or not perturbations.has("plane"):
        return built
    height_m = built.simulation.camera_height_m - 1e-3 * perturbations["plane"]
    return built.model_copy(update={"simulation": _with(built.simulation, camera_height_m=height_m)})


def plane_tilt(perturbations: Perturbations, seed: int) -> Array:
    """The rotation from the true to the stated normal of the plane, in the camera's axes, shape (3, 3)."""
    along = direction(seed, "plane_tilt", 2)
    return rotation_of(np.array([*along, 0.0]) * np.deg2rad(perturbations["plane_tilt"]))


def _changed(profile: Profile, perturbations: Perturbations, seed: int, sign: int) -> Profile:
    """Say what is not so (`sign` 1), or build what is not said (-1)."""
    update: dict[str, object] = {
        "robot": _robot(profile.robot, perturbations, sign),
        "instrument": _instrument(profile.instrument, perturbations, sign),
        "fiducial": _fiducial(profile.fiducial, perturbations, seed, sign),
        "tissue": _tissue(profile.tissue, perturbations, seed, sign),
        "other_instruments": tuple(
            _with(
                other,
                robot=_robot(other.robot, perturbations, sign),
                instrument=_instrument(other.instrument, perturbations, sign),
            )
            for other in profile.other_instruments
        ),
    }
    return profile.model_copy(update=update)


def _scaled(length_m: float, percent: float, sign: int) -> float:
    return float(length_m * (1.0 + 1e-2 * percent) ** sign)


def _robot(robot: Robot | None, perturbations: Perturbations, sign: int) -> Robot | None:
    """The wrist's length is the last one along a link's x axis: from its pitch to its yaw."""
    if robot is None or not perturbations.has("wrist_length"):
        return robot
    places = [index for index, joint in enumerate(robot.joints) if joint.a_m]
    if not places:
        return robot
    joints = list(robot.joints)
    last = joints[places[-1]]
    joints[places[-1]] = _with(last, a_m=last.a_m + sign * 1e-3 * perturbations["wrist_length"])
    return _with(robot, joints=tuple(joints))


def _instrument(instrument: Instrument | None, perturbations: Perturbations, sign: int) -> Instrument | None:
    if instrument is None or not perturbations.has("shaft_radius", "knuckle_radius"):
        return instrument
    return _with(
        instrument,
        shaft_radius_m=_scaled(instrument.shaft_radius_m, perturbations["shaft_radius"], sign),
        knuckle_radius_m=_scaled(instrument.knuckle_radius_m, perturbations["knuckle_radius"], sign),
    )


def _fiducial(
    fiducial: Fiducial | None, perturbations: Perturbations, seed: int, sign: int
) -> Fiducial | None:
    if fiducial is None or not perturbations.has("tag_size", "tag_mount"):
        return fiducial
    update: dict[str, object] = {"size_m": _scaled(fiducial.size_m, perturbations["tag_size"], sign)}
    if perturbations.has("tag_mount"):
        mount_mm = sign * perturbations["tag_mount"]
        shift_m = 1e-3 * mount_mm * direction(seed, "tag_mount", 3)
        turn = rotation_of(np.deg2rad(TURN_DEG_PER_MM) * mount_mm * direction(seed, "tag_mount turn", 3))
        R = np.array(fiducial.rotation) @ turn
        update["position_m"] = tuple((np.array(fiducial.position_m) + shift_m).tolist())
        update["rotation"] = tuple(tuple(row) for row in R.tolist())
    return _with(fiducial, **update)


def _tissue(tissue: Tissue | None, perturbations: Perturbations, seed: int, sign: int) -> Tissue | None:
    if tissue is None or not perturbations.has("plane", "plane_tilt"):
        return tissue
    distance_m = tissue.plane_distance_m + sign * 1e-3 * perturbations["plane"]
    if distance_m <= 0.0:
        raise UsageError(f"perturbation plane: the plane would be {-1e3 * distance_m:g} mm behind the camera")
    R = plane_tilt(perturbations, seed)
    normal = (R if sign > 0 else R.T) @ tissue.plane_normal
    return _with(
        tissue,
        plane_distance_m=distance_m,
        plane_normal=tuple((normal / np.linalg.norm(normal)).tolist()),
    )


def _with(model: Model, **update: object) -> Model:
    """A copy of a part of a profile; the ranges of the table keep its values possible."""
    return model.model_copy(update=dict(update))
