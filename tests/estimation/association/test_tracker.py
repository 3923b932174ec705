"""Association on synthetic tracks that cross, merge and drop out: no instrument ever gets another's name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from svmdist.estimation.region_tracking import Blob, Gaussian, NominalPlace, RegionTracker
from svmdist.transforms import Array

WIDTH_PX, HEIGHT_PX, RADIUS_PX, FOCAL_PX, DEPTH_M = 640, 480, 11.0, 554.0, 0.09
RATE_HZ, COUNT = 8.0, 64
PRIOR_PX = 250.0


@dataclass(frozen=True)
class Counted:
    """How often an instrument was named, and how often by another one's region."""

    named: int
    swapped: int


def crossing_paths(rng: np.random.Generator) -> Array:
    """Two instruments' positions in the camera frame, shape (n, 2, 3) in m; the second one crosses the first thrice."""
    s = np.linspace(0.0, 1.0, COUNT)[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    first = np.hstack(
        [0.02 * np.sin(2 * np.pi * 1.5 * s + phase[0]), 0.014 * np.sin(2 * np.pi * s + phase[1])]
    )
    turn = rng.uniform(0.0, 2.0 * np.pi)
    swing = 0.02 * np.cos(2 * np.pi * 1.5 * s + 0.1 * phase[2]) * [np.cos(turn), np.sin(turn)]
    offset = rng.uniform(-0.001, 0.001, 2)
    height = DEPTH_M + 0.006 * np.sin(2 * np.pi * 1.3 * s + phase[2])
    return np.stack([np.hstack([first, height]), np.hstack([first + swing + offset, height - 0.015])], axis=1)


def seen(position_m: Array) -> Array:
    """The pixel of a point, shape (2,)."""
    return np.array([WIDTH_PX, HEIGHT_PX]) / 2.0 + FOCAL_PX * position_m[:2] / position_m[2]


def blobs_of(pixels: Array, rng: np.random.Generator, dropout: float) -> tuple[list[Blob], list[set[int]]]:
    """Regions as segmentation gives them, and whose they are: discs that touch are one, some are missing."""
    there = [i for i in range(len(pixels)) if rng.uniform() >= dropout]
    area = np.pi * RADIUS_PX**2
    if len(there) == 2 and np.linalg.norm(pixels[0] - pixels[1]) < 2.0 * RADIUS_PX:
        apart = float(np.linalg.norm(pixels[0] - pixels[1])) / (2.0 * RADIUS_PX)
        return [Blob(pixels.mean(0), area * (1.0 + apart))], [{0, 1}]
    blobs = [Blob(pixels[i] + rng.normal(0.0, 1.0, 2), area * rng.uniform(0.9, 1.1)) for i in there]
    owners = [{i} for i in there]
    order = rng.permutation(len(blobs))
    return [blobs[k] for k in order], [owners[k] for k in order]


def follow(seed: int, dropout: float, blind_from: int = COUNT) -> Counted:
    """Track one scene; the robot errs by centimetres, and says nothing from frame `blind_from` on."""
    rng = np.random.default_rng(seed)
    paths = crossing_paths(rng)
    errors_m = rng.normal(0.0, 0.025, (2, 3)) * [1.0, 1.0, 0.5]
    tracker = RegionTracker(2, WIDTH_PX, HEIGHT_PX)
    named = swapped = 0
    for frame, positions in enumerate(paths):
        pixels = np.array([seen(p) for p in positions])
        blobs, owners = blobs_of(pixels, rng, dropout)
        wrong = positions + errors_m
        places = [
            NominalPlace(Gaussian(seen(p), PRIOR_PX**2 * np.eye(2)), p, FOCAL_PX / p[2])
            if frame < blind_from
            else None
            for p in wrong
        ]
        # Whose shaft is behind a region is told at once; nothing else tells an unknown robot's instruments apart.
        evidence = np.array([[2.0 if who == {i} else 0.0 for who in owners] for i in range(2)]).reshape(2, -1)
        for i, identity in enumerate(
            tracker.update(frame * int(1e9 / RATE_HZ), places, blobs, evidence if frame < 8 else None)
        ):
            if identity.blob is not None:
                named += 1
                swapped += i not in owners[identity.blob]
    return Counted(named, swapped)


@pytest.mark.parametrize("dropout", [0.0, 0.1, 0.3])
def test_no_swap_through_crossings(dropout: float) -> None:
    """Three crossings, merged regions and missing ones, centimetres of kinematic error: no swap in 15 scenes."""
    counts = [follow(seed, dropout) for seed in range(15)]
    assert sum(count.swapped for count in counts) == 0
    # All regions are named but those that two instruments contest: fewer than one in eight.
    assert sum(count.named for count in counts) > 0.875 * (1.0 - dropout) * 15 * 2 * COUNT


def test_no_swap_without_kinematics() -> None:
    """The robot falls silent after two seconds: constant velocity carries both names through the rest.

    Where it cannot, as in the last of these scenes, names are given up rather than guessed.
    """
    counts = [follow(seed, 0.05, blind_from=16) for seed in (*range(100, 130), 71342)]
    assert sum(count.swapped for count in counts) == 0
    assert sum(count.named for count in counts) > 0.8 * len(counts) * 2 * COUNT


def test_nobody_is_named_without_a_reason() -> None:
    """Two alike regions, and nominal kinematics that fit either way: no name, rather than a guess."""
    tracker = RegionTracker(2, WIDTH_PX, HEIGHT_PX)
    place = NominalPlace(
        Gaussian(np.array([320.0, 240.0]), PRIOR_PX**2 * np.eye(2)), np.array([0.0, 0.0, 0.1]), 5540.0
    )
    blobs = [Blob(np.array([x, 240.0]), 380.0) for x in (300.0, 340.0)]
    assert [one.blob for one in tracker.update(0, [place, place], blobs)] == [None, None]
    assert [one.blob for one in tracker.update(1, [None, None], blobs)] == [None, None]
    named = tracker.update(2, [place, place], blobs, np.array([[0.0, 2.0], [2.0, 0.0]]))
    assert [one.blob for one in named] == [1, 0]


def test_size_names_nobody() -> None:
    """Regions that swap their sizes from one image to the next keep their names."""
    tracker = RegionTracker(2, WIDTH_PX, HEIGHT_PX)
    centres_px = [np.array([200.0, 200.0]), np.array([420.0, 260.0])]
    places = [NominalPlace(Gaussian(p, 20.0**2 * np.eye(2)), np.array([*p, 1.0]), 1.0) for p in centres_px]
    for frame in range(6):
        areas = (380.0, 900.0) if frame % 2 else (900.0, 380.0)
        blobs = [Blob(p, area) for p, area in zip(centres_px, areas, strict=True)]
        named = tracker.update(frame * 100_000_000, places, blobs)
        assert [one.blob for one in named] == [0, 1]
