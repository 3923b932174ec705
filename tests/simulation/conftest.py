from collections.abc import Iterator

import numpy as np
import pytest

from svmdist.kinematics import solve_position
from svmdist.perturbations import UNPERTURBED, Perturbations, parse_perturbations
from svmdist.profile import Profile, load_profile
from svmdist.samples import Sample
from svmdist.simulation.motion import Scenario
from svmdist.simulation.scene import PLAIN, Options, Scene, make_scene
from svmdist.transforms import Array, inverse, transform_points


@pytest.fixture(scope="session")
def profile() -> Profile:
    return load_profile()


@pytest.fixture(scope="session")
def scene(profile: Profile) -> Scene:
    return make_scene(profile, 1)


def chosen(text: str) -> Perturbations:
    return parse_perturbations(text) if text else UNPERTURBED


def perturbed(text: str, **options: object) -> Options:
    return Options(perturbations=chosen(text), **options)


def simulate(scenario: Scenario, profile: Profile, options: Options = PLAIN) -> Iterator[tuple[str, Sample]]:
    """Topics and samples of a recording."""
    from svmdist.simulation.plan import make_plan
    from svmdist.simulation.simulate import Simulator

    plan = make_plan(scenario, profile, options)
    with Simulator(plan) as simulator:
        for block in plan.blocks:
            yield from simulator.samples(block, simulator.sensors.draw_noise())


def posed(scene: Scene, p_world_m: object, wrist_rad: object = 0.0) -> Array:
    """Joints with the tool's origin at a point of the world."""
    q = scene.posture.copy()
    q[-4:] += wrist_rad
    target_m = transform_points(inverse(scene.T_world_base), np.array([p_world_m]))
    return solve_position(scene.chain, q[None], target_m, ("yaw", "pitch", "insertion"))[0]


def withdrawn(scene: Scene) -> Array:
    """Joints with the instrument out of the image."""
    q = scene.posture.copy()
    q[scene.chain.joint_names.index("insertion")] = 0.02
    return q
