"""What a recording can have beyond the plain one. The defaults leave it plain, to the last bit."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.errors import UsageError
from svmdist.perturbations.chosen import UNPERTURBED, Perturbations, World, require_at_record
from svmdist.simulation.room.settings import Room
from svmdist.vision.degradations import require_degradation

MAX_ARMS = 2
MAX_RELIEF_M = 0.0015
"""Beyond this, vessels would be steeper than 45°."""


@dataclass(frozen=True)
class Extras:
    """Options of a simulation.

    `stereo` adds the right camera, `tag` mounts the profile's fiducial plate, `kinematic_error` scales
    the error of the robot's nominal kinematics, in its joints and in the camera's place (0 none, 1 as the profile
    says). `degradations` spoil the images, one after the other, behind the sensor's noise: (name, severity).
    `arms` is the number of instruments.
    `relief_m` is how far bumps, folds and vessels rise over the smooth organ, or lie below it, at most.
    `perturbations` are what is not as log and profile say; `world` is what they were drawn for.
    """

    stereo: bool = False
    tag: bool = False
    kinematic_error: float = 0.0
    degradations: tuple[tuple[str, int], ...] = ()
    arms: int = 1
    relief_m: float = 0.0
    perturbations: Perturbations = UNPERTURBED
    world: World = World.IDEAL

    def __post_init__(self) -> None:
        if not 0.0 <= self.kinematic_error <= 20.0:
            raise UsageError(
                f"the scale of the kinematic error is from 0 to 20, found {self.kinematic_error:g}"
            )
        if not 1 <= self.arms <= MAX_ARMS:
            raise UsageError(f"a recording has 1 to {MAX_ARMS} arms, found {self.arms}")
        if not 0.0 <= self.relief_m <= MAX_RELIEF_M:
            raise UsageError(
                f"the tissue's relief is from 0 to {MAX_RELIEF_M * 1e3:g} mm, found {self.relief_m * 1e3:g} mm"
            )
        for name, severity in self.degradations:
            require_degradation(name, severity)
        require_at_record(self.perturbations)

    @property
    def room(self) -> Room:
        """What of the perturbations images and tissue show."""
        return Room.of(self.perturbations)

    def metadata(self) -> dict[str, str]:
        """Name what is set, for a recording's metadata; a plain recording names nothing."""
        named = {
            "stereo": "yes" if self.stereo else "",
            "tag": "yes" if self.tag else "",
            "kinematic_error": f"{self.kinematic_error:g}" if self.kinematic_error else "",
            "arms": str(self.arms) if self.arms > 1 else "",
            "degrade": ",".join(f"{name}={severity}" for name, severity in self.degradations),
            "relief_m": f"{self.relief_m:g}" if self.relief_m else "",
            "world": "" if self.world is World.IDEAL else self.world.value,
            "perturb": str(self.perturbations),
        }
        return {name: value for name, value in named.items() if value}
