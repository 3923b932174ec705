"""Association: instruments keep their names through crossings, by kinematics, continuity and the side of entry."""

from collections.abc import Sequence

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.entries import EntryTracker, disagreement
from svmdist.estimation.region_tracking import Blob, Gaussian, NominalPlace, RegionTracker
from svmdist.profile.robot import Instrument
from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.lines import tangent_normal

WIDTH_PX, HEIGHT_PX, RADIUS_PX, FOCAL_PX, DEPTH_M = 640, 480, 11.0, 554.0, 0.09
RATE_HZ, COUNT = 8.0, 64
PRIOR_PX = 250.0


def crossing_paths(rng: np.random.Generator) -> Array:
    """Two instruments' positions in the camera frame, shape (n, 2, 3) in m; the second one crosses the first thrice."""
    s = np.linspace(0.0, 1.0, COUNT)[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    first = np.hstack([0.02 * np.sin(2 * np.pi * 1.5 * s + phase[0]), 0.014 * np.sin(2 * np.pi * s + phase[1])])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    swing = 0.02 * np.cos(2 * np.pi * 1.5 * s + 0.1 * phase[2]) * [np.cos(turn), np.sin(turn)]
    offset = rng.uniform(-0.001, 0.001, 2)
    height = DEPTH_M + 0.006 * np.sin(2 * np.pi * 1.3 * s + phase[2])
    return np.stack([np.hstack([first, height]), np.hstack([first + swing + offset, height - 0.015])], axis=1)


def pixels_of(positions_m: Array) -> Array:
    """The pixels of points, shape (n, 2)."""
    return np.array([WIDTH_PX, HEIGHT_PX]) / 2.0 + FOCAL_PX * positions_m[:, :2] / positions_m[:, 2:]


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


def follow(seed: int, dropout: float, blind_from: int = COUNT, silent: Sequence[int] = ()) -> Array:
    """How often instruments were named, and by another's region: robots are off, and some silent from a frame on."""
    rng = np.random.default_rng(seed)
    paths = crossing_paths(rng)
    errors_m = rng.normal(0.0, 0.025, (2, 3)) * [1.0, 1.0, 0.5]
    tracker = RegionTracker(2, WIDTH_PX, HEIGHT_PX, AssociationSettings())
    named = swapped = 0
    for frame, positions in enumerate(paths):
        pixels = pixels_of(positions)
        blobs, owners = blobs_of(pixels, rng, dropout)
        wrong = positions + errors_m
        places: list[NominalPlace | None] = [
            NominalPlace(Gaussian(pixel, PRIOR_PX**2 * np.eye(2)), p, FOCAL_PX / p[2])
            for p, pixel in zip(wrong, pixels_of(wrong), strict=True)
        ]
        if frame >= blind_from:
            places = [None if at in silent else place for at, place in enumerate(places)]
        # Whose shaft is behind a region is told at once; nothing else tells an unknown robot's instruments apart.
        evidence = np.array([[2.0 if who == {i} else 0.0 for who in owners] for i in range(2)]).reshape(2, -1)
        stamp_ns = frame * int(1e9 / RATE_HZ)
        identities = tracker.update(stamp_ns, places, blobs, evidence if frame < 8 else None)
        for i, identity in enumerate(identities):
            if identity.blob is not None:
                named += 1
                swapped += i not in owners[identity.blob]
    return np.array([named, swapped])


LOST = (*range(100, 130), 71342), 0.05, 16


@pytest.mark.parametrize(
    ("seeds", "dropout", "blind_from", "silent", "share"),
    [
        *((tuple(range(15)), dropout, COUNT, (), 0.875 * (1.0 - dropout)) for dropout in (0.0, 0.1, 0.3)),
        (*LOST, (1,), 0.85),
        (*LOST, (0, 1), 0.4),
    ],
    ids=["no dropout", "10 %", "30 %", "one lost", "both lost"],
)
def test_no_swap_through_crossings(seeds, dropout, blind_from, silent, share):
    """Three crossings, merged regions and missing ones, centimetres of kinematic error: no swap in any scene.

    All regions are named but those that two instruments contest: fewer than one in eight. Where one robot falls silent,
    its instrument is what the other one is not; where both do, names are given up at the next crossing.
    """
    named, swapped = sum(follow(seed, dropout, blind_from, silent) for seed in seeds)
    assert swapped == 0
    assert named > share * len(seeds) * 2 * COUNT


TWO = (("A", "B"), (None, None))
SECOND = 10**9


def entering(entry: Sequence[float], end: Sequence[float]) -> SeenInstrument:
    """An instrument that comes in at one pixel and ends at another."""
    sides = np.array([[entry, end], [entry, end]], np.float64)
    return SeenInstrument(np.zeros((1, 1), np.bool_), (HEIGHT_PX, WIDTH_PX), sides, np.array(end, float), 0.5)


def test_from_left_to_right_in_the_order_of_the_profile():
    """Whatever the order in which they are found; one alone is named by its side too."""
    left, right = entering((0, 200), (250, 260)), entering((639, 180), (380, 250))
    for found, named in (
        ([right, left], [1, 0]),
        ([right], [None, 0]),
        ([left], [0, None]),
        ([], [None, None]),
    ):
        assert EntryTracker(*TWO).update(0, found)[0] == named


def test_tips_that_cross_keep_their_names():
    """Trocars stay where they are: 200 courses with tips anywhere, noise, misses and any order."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        watch = EntryTracker(*TWO)
        places = np.array([[5.0, rng.uniform(100, 400)], [634.0, rng.uniform(100, 400)]])
        phase = rng.uniform(0.0, 6.28, 2)
        for step in range(40):
            shown = [at for at in rng.permutation(2) if rng.random() > 0.2]
            found = []
            for at in shown:
                entry = places[at] + rng.normal(0.0, 6.0, 2)
                end = [320 + 120 * np.sin(0.3 * step + phase[at]), 260 + 60 * np.cos(0.23 * step + phase[at])]
                found.append(entering(entry, end))
            for name, (at, doubt) in enumerate(zip(*watch.update(step * SECOND // 8, found), strict=True)):
                assert at is None or doubt or shown[at] == name


def shaft_seen(camera: Camera, T_camera_left: Array, end_m: Array, direction: Array) -> SeenInstrument:
    """A shaft of 4 mm radius with 40 mm in view, in a camera that is elsewhere than the left one."""
    ends_m = np.array([end_m - 0.04 * direction, end_m]) @ T_camera_left[:3, :3].T + T_camera_left[:3, 3]
    along = T_camera_left[:3, :3] @ direction
    normals = [tangent_normal(ends_m[1], along, 0.004, side)[0] for side in (-1, 1)]
    sides = np.array([camera.project(ends_m - 0.004 * normal) for normal in normals])
    end_px, none = sides[:, 1].mean(0), np.zeros((2, 2), np.bool_)
    return SeenInstrument(none, (2, 2), sides, end_px, 1.0, np.full((2, 2, 2), 0.1) * np.eye(2), 3.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_shaft_is_told_in_the_right_view_by_its_depth(seed):
    """Of two shafts 15 mm apart both views' own agree within 4 deviations, and the other is beyond 24 squared."""
    rng = np.random.default_rng(seed)
    camera = Camera(1280, 1024, np.array([[900.0, 0, 640], [0, 900.0, 512], [0, 0, 1]]))
    T_right_left = make_transform(rotation_of([0.0, 0.05, 0.01]), [-0.005, 0.0005, 0.0])
    instrument = Instrument(
        shaft_radius_m=0.004,
        shaft_length_m=0.3,
        wrist_radius_m=0.003,
        knuckle_radius_m=0.002,
        jaw_length_m=0.01,
        jaw_radius_m=0.001,
    )
    first_m, direction = rng.uniform([-0.02, -0.02, 0.09], [0.02, 0.02, 0.13]), np.array([0.8, 0.2, 0.57])
    direction /= np.linalg.norm(direction)
    other_m = first_m + np.array([0.0, 0.015, rng.uniform(-0.01, 0.01)])
    left = shaft_seen(camera, np.eye(4), first_m, direction)
    own, other = (shaft_seen(camera, T_right_left, at_m, direction) for at_m in (first_m, other_m))
    assert disagreement(left, own, (camera, camera), T_right_left, instrument) < 16.0
    assert disagreement(left, other, (camera, camera), T_right_left, instrument) > 24.0


@pytest.mark.parametrize(("off_px", "is_named"), [(0.0, True), (10.0, False)])
def test_a_region_beside_its_track_may_be_one_not_yet_seen(off_px, is_named):
    """Where the robot puts another instrument there, however roughly, a region off its track's path is contested."""
    tracker, at_px = RegionTracker(2, WIDTH_PX, HEIGHT_PX, AssociationSettings()), np.array([300.0, 200.0])
    stds_px, p = (10.0, 0.15 * WIDTH_PX), np.array([0.0, 0.0, 0.1])
    places = [NominalPlace(Gaussian(at_px, std_px**2 * np.eye(2)), p, FOCAL_PX / p[2]) for std_px in stds_px]
    for frame in range(12):
        seen_px = at_px + np.array([off_px if frame == 11 else 0.0, 0.0])
        blobs = [Blob(seen_px, np.pi * RADIUS_PX**2)]
        first, second = tracker.update(frame * int(1e9 / RATE_HZ), places, blobs)
        assert second.blob is None
    assert (first.blob == 0) == is_named


def test_motion_tells_what_a_first_image_does_not():
    """Two instruments whose robots are off the other way round: none is named by that, and both by their motion."""
    tracker = RegionTracker(2, WIDTH_PX, HEIGHT_PX, AssociationSettings())
    at_m = np.array([[0.02, 0.01, DEPTH_M], [0.01, 0.02, DEPTH_M]])
    # Each is nominally nearer to where the other one is.
    off_m = np.array([[-0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])
    speeds_m = np.array([[0.0, 0.0, 0.0], [-0.002, -0.0005, 0.0]])
    named = []
    for frame in range(20):
        true_m = at_m + frame * speeds_m
        wrong_m = true_m + off_m
        places = [
            NominalPlace(Gaussian(pixel, (0.4 * PRIOR_PX) ** 2 * np.eye(2)), p, FOCAL_PX / p[2])
            for p, pixel in zip(wrong_m, pixels_of(wrong_m), strict=True)
        ]
        blobs = [Blob(pixel, np.pi * RADIUS_PX**2) for pixel in pixels_of(true_m)]
        named.append([one.blob for one in tracker.update(frame * int(1e9 / RATE_HZ), places, blobs)])
    assert named[0] == [None, None]
    assert named[-1] == [0, 1]
    assert [1, 0] not in named
