"""The ideal world is what it was, bit by bit, and any world is the same whoever draws it."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from svmdist.perturbations.chosen import World, draw_world, parse_perturbations
from svmdist.perturbations.image_table import IMAGES
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.samples import CameraSample, DistanceSample, ImageSample, JointSample
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.room.settings import IDEAL, Room

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import make_plan
from svmdist.simulation.simulate import Simulator, simulate


def test_the_ideal_world_is_that_of_the_golden_logs(golden: Path, profile: Profile) -> None:
    """The first frames of a log that was made before there was any other world: each pixel, joint and distance."""
    samples = simulate(Scenario("sweep", 1), profile)
    drawn = list(islice((s.image_bgr for _, s in samples if isinstance(s, ImageSample)), 2))
    recording = open_recording(golden / "sweep.mcap", profile)
    logged = [observation.image_bgr for observation in islice(recording.observations(), 2)]
    np.testing.assert_array_equal(drawn, logged)


def test_neutral_strengths_change_nothing(profile: Profile) -> None:
    neutral = parse_perturbations(",".join(f"{entry.name}=0" for entry in IMAGES))
    plain, other = (
        list(simulate(Scenario("contact", 3, 0.4, 5.0), profile, noise=2.0, extras=extras))
        for extras in (Extras(stereo=True), Extras(stereo=True, perturbations=neutral))
    )
    assert [topic for topic, _ in plain] == [topic for topic, _ in other]
    for (_, expected), (_, sample) in zip(plain, other, strict=True):
        match sample, expected:
            case ImageSample(), ImageSample():
                np.testing.assert_array_equal(sample.image_bgr, expected.image_bgr)
            case JointSample(), JointSample():
                np.testing.assert_array_equal(sample.positions, expected.positions)
            case DistanceSample(), DistanceSample():
                assert sample == expected
            case CameraSample(), CameraSample():
                np.testing.assert_array_equal(sample.camera.D, expected.camera.D)


def test_every_entry_reaches_the_room() -> None:
    assert set(Room.__dataclass_fields__) == {entry.name for entry in IMAGES}
    for entry in IMAGES:
        assert Room.of(parse_perturbations(f"{entry.name}={entry.high}")) != IDEAL


def test_a_real_world_is_the_same_in_any_order(profile: Profile) -> None:
    """Blocks forth and back, as processes would make them: moving tissue, two fields and shadows among the rest."""
    assert profile.simulation is not None
    small = profile.model_copy(
        update={"simulation": profile.simulation.model_copy(update={"width_px": 160, "height_px": 120})}
    )
    extras = Extras(stereo=True, tag=True, perturbations=draw_world(World.REAL, 5), world=World.REAL)
    plan = make_plan(Scenario("random", 5, 0.9, 3.4), small, noise=1.0, extras=extras)
    images: dict[bool, dict[int, list[np.ndarray]]] = {}
    for backwards in (False, True):
        with Simulator(plan) as simulator:
            noises = {block.frame: simulator.draw_noise() for block in plan.blocks}
            blocks = plan.blocks[::-1] if backwards else plan.blocks
            images[backwards] = {
                block.frame: [
                    sample.image_bgr
                    for _, sample in simulator.samples(block, noises[block.frame])
                    if isinstance(sample, ImageSample)
                ]
                for block in blocks
            }
    assert len(images[True]) == 3
    for frame, forth in images[False].items():
        np.testing.assert_array_equal(forth, images[True][frame])
