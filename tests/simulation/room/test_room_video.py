"""Round border, darker corners, two fields, and colour at half size."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.perturbations.chosen import parse_perturbations
from svmdist.perturbations.images import perturbed_image
from svmdist.perturbations.images import border_radius_px, dimmed, light_left, subsampled
from svmdist.profile import Profile
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.effects import FIELD_NS, exposures, exposures_at_most
from svmdist.simulation.effects import Room

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import make_plan
from svmdist.simulation.render import Renderer
from svmdist.simulation.shutter import motion_px
from svmdist.simulation.simulate import Simulator

WIDTH, HEIGHT = 640, 480


def test_the_border_is_round_and_black_outside() -> None:
    """At 1 its circle reaches the image's left and right side; 2 px inside nothing is darker, 2 px outside all is."""
    plain = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    image = dimmed(plain, 1.0, 0.0)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    radius_px = np.hypot(columns - 319.5, rows - 239.5)
    assert (image[radius_px > 322.0] == 0).all()
    assert (image[radius_px < 318.0] == 200).all()
    assert border_radius_px(WIDTH, HEIGHT, 0.0) == pytest.approx(400.0)
    left = light_left(0.0, 0.3, WIDTH, HEIGHT)
    assert left.min() == pytest.approx(0.7, abs=1e-12)
    assert left.max() > 0.9999
    assert dimmed(plain, 0.0, 0.0) is plain


def test_a_log_is_replayed_as_it_would_have_been_recorded(profile: Profile) -> None:
    """Border, corners and colour done to an image of the ideal world are those of a recording, bit by bit."""
    chosen = parse_perturbations("border=0.8,vignette=0.3,chroma=1")
    drawn = []
    for extras in (Extras(), Extras(perturbations=chosen)):
        plan = make_plan(Scenario("sweep", 1, 0.2, 5.0), profile, extras=extras)
        with Simulator(plan) as simulator:
            samples = simulator.samples(plan.blocks[0], (None,))
            drawn.append(next(s.image_bgr for _, s in samples if hasattr(s, "image_bgr")))
    np.testing.assert_array_equal(perturbed_image(drawn[0], chosen), drawn[1])
    assert (drawn[0] != drawn[1]).any(axis=2).mean() > 0.5


def test_colour_is_kept_for_two_by_two_pixels() -> None:
    """Brightness stays within 2 levels; stripes of two colours as bright become one colour."""
    luma, (first, second) = 120, ((90, 160), (170, 100))
    y_cr_cb = np.full((HEIGHT, WIDTH, 3), luma, np.uint8)
    y_cr_cb[:, ::2, 1:], y_cr_cb[:, 1::2, 1:] = first, second
    image = np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)
    seen = cv2.cvtColor(subsampled(image, 1.0), cv2.COLOR_BGR2YCrCb).astype(int)
    assert np.abs(seen[..., 0] - luma).max() <= 2
    assert np.ptp(seen[..., 1]) <= 4
    assert seen[..., 1].mean() == pytest.approx(130.0, abs=3.0)
    np.testing.assert_allclose(subsampled(image, 0.0).astype(int), image, atol=3)
    odd = subsampled(image[: HEIGHT - 1, : WIDTH - 1], 1.0)
    assert odd.shape == (HEIGHT - 1, WIDTH - 1, 3)


def test_odd_rows_are_a_field_later(profile: Profile) -> None:
    """Even rows show the stamp's instant, odd ones that of 2/60 s later, each as if it were drawn alone."""
    extras = Extras(perturbations=parse_perturbations("interlace=2,breathing=2"))
    plan = make_plan(Scenario("sweep", 1, 2.0, 2.0), profile, extras=extras)
    block = plan.blocks[1]
    with Simulator(plan) as simulator:
        frame = next(s.image_bgr for _, s in simulator.samples(block, (None,)) if hasattr(s, "image_bgr"))
    drawn = []
    with Renderer(plan.scene, seed=1) as renderer:
        for number, after_ns in enumerate((0.0, 2.0 * FIELD_NS)):
            moment = plan.moment(block.begin, after_ns)
            drawn.append(renderer.frame_of(moment.q[0], turn=2 + number, rise_m=moment.rise_m))
    np.testing.assert_array_equal(frame[::2], drawn[0][::2])
    np.testing.assert_array_equal(frame[1::2], drawn[1][1::2])
    assert np.abs(drawn[0][1::2].astype(int) - drawn[1][1::2]).max() > 60


def test_rows_are_exposed_one_after_another(profile: Profile) -> None:
    """Over 20 ms: each row shows its own instant as if it were drawn alone, and the middle one that of the stamp."""
    extras = Extras(perturbations=parse_perturbations("rolling=20,breathing=2"))
    plan = make_plan(Scenario("sweep", 1, 2.0, 2.0), profile, extras=extras)
    block = plan.blocks[1]
    with Simulator(plan) as simulator:
        frame = next(s.image_bgr for _, s in simulator.samples(block, (None,)) if hasattr(s, "image_bgr"))
    bands = exposures(plan.scene.room, HEIGHT, motion_px(plan, block.begin))
    assert len(bands) > 10
    with Renderer(plan.scene, seed=1) as renderer:
        for number, band in enumerate(bands):
            middle_ms = 20.0 * (0.5 * (band.first + band.end) / HEIGHT - 0.5)
            assert band.after_ns == pytest.approx(1e6 * middle_ms)
            if number % 5 == 0:
                moment = plan.moment(block.begin, 1e6 * middle_ms)
                drawn = renderer.frame_of(moment.q[0], turn=48 + number, rise_m=moment.rise_m)
                np.testing.assert_array_equal(frame[band.rows], drawn[band.rows])
        still = renderer.frame_of(plan.moment(block.begin).q[0], rise_m=plan.moment(block.begin).rise_m)
    different = (np.abs(frame.astype(int) - still) > 20).any(axis=2)
    assert different.sum() > 500


@pytest.mark.parametrize(
    "room", [Room(), Room(interlace=1.0), Room(rolling=30.0), Room(interlace=1.0, rolling=30.0)]
)
def test_every_row_is_exposed_once(room: Room) -> None:
    """In bands that things cross in steps of 0.4 px, of a frame whose height their number does not divide."""
    for motion in (0.0, 3.3, 1000.0):
        parts = exposures(room, 479, motion)
        rows = np.concatenate([np.arange(479)[part.rows] for part in parts])
        np.testing.assert_array_equal(np.sort(rows), np.arange(479))
        assert len(parts) <= exposures_at_most(room)
        if room.rolling:
            assert motion / len(parts) <= 0.4 or len(parts) == exposures_at_most(room)


def test_fields_and_bands_go_together() -> None:
    """Odd rows are a field later than even ones, and each row later than the one two before it."""
    parts = exposures(Room(interlace=1.0, rolling=10.0), HEIGHT, 8.0)
    after_ns = np.empty(HEIGHT)
    for part in parts:
        after_ns[part.rows] = part.after_ns
    np.testing.assert_allclose(after_ns[1::2] - after_ns[::2], FIELD_NS, atol=1e-3)
    assert np.ptp(after_ns[::2]) == pytest.approx(1e7, rel=0.06)
    assert (np.diff(after_ns[::2]) >= 0.0).all()


def test_motion_grows_with_the_time_that_rows_take(profile: Profile) -> None:
    """Twice the time, twice the way; none without a rolling shutter."""
    assert motion_px(make_plan(Scenario("sweep", 1, 1.0, 2.0), profile), 0) == 0.0
    rolling = make_plan(
        Scenario("sweep", 1, 1.0, 2.0),
        profile,
        extras=Extras(perturbations=parse_perturbations("rolling=10")),
    )
    twice = make_plan(
        Scenario("sweep", 1, 1.0, 2.0),
        profile,
        extras=Extras(perturbations=parse_perturbations("rolling=20")),
    )
    assert motion_px(twice, 40) == pytest.approx(2.0 * motion_px(rolling, 40), rel=0.05)


def test_a_moment_lies_between_two_stamps(profile: Profile) -> None:
    plan = make_plan(Scenario("sweep", 1, 1.0, 2.0), profile)
    q, step_ns = plan.arms[0].q, float(plan.stamps_ns[4] - plan.stamps_ns[3])
    np.testing.assert_array_equal(plan.moment(3).q[0], q[3])
    np.testing.assert_allclose(plan.moment(3, 0.25 * step_ns).q[0], 0.75 * q[3] + 0.25 * q[4], atol=1e-15)
    np.testing.assert_array_equal(plan.moment(len(q) - 1, 1e9).q[0], q[-1])
    np.testing.assert_allclose(plan.moment(3, -0.25 * step_ns).q[0], 0.75 * q[3] + 0.25 * q[2], atol=1e-15)
    first_ns = float(plan.stamps_ns[1] - plan.stamps_ns[0])
    np.testing.assert_allclose(plan.moment(0, -0.5 * first_ns).q[0], 1.5 * q[0] - 0.5 * q[1], atol=1e-15)
