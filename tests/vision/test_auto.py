"""Instruments in random pictures: found where there are any, none in bare tissue, whatever border and light."""

import cv2
import numpy as np
import pytest

from benchmarks.masks import iou
from svmdist.estimation.instrument.shaft import ShaftSizes
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.profile.settings import AutoSettings
from svmdist.recording.log import open_recording
from svmdist.samples import Image
from svmdist.vision.edge_lines import EdgeLine, edge_within
from svmdist.vision.frame_context import FrameContext, make_segmenter
from svmdist.vision.instruments.evidence import Evidence, picture_of
from svmdist.vision.instruments.find_instruments import SeenInstrument, auto_masks, find_instruments
from svmdist.vision.instruments.outline import Outline
from svmdist.vision.instruments.outline_search import outline_score
from svmdist.vision.silhouette import Silhouette, WristShape, find_silhouette
from tests.pictures import BORDERS, surgery_image
from tests.reading import read_images
from tests.shipped import PROFILE


def instruments(bgr: Image) -> np.ndarray:
    """All instruments' pixels, shape (h, w)."""
    masks = [one.mask > 0 for one in auto_masks(bgr).seen]
    return np.any(masks, axis=0) if masks else np.zeros(bgr.shape[:2], np.bool_)


def sides_of(end: float = 200.0, top: float = 99.5, bottom: float = 139.5) -> np.ndarray:
    """The sides of a shaft that comes in from the left, shape (2, 2, 2)."""
    return np.array([[[0.0, top], [end, top]], [[0.0, bottom], [end, bottom]]])


def seen_as(mask: np.ndarray, sides: np.ndarray, **known: object) -> SeenInstrument:
    """An instrument in a picture of 320x240 px, whose end is between those of its sides, to 2 px."""
    known = {"end_px": sides[:, 1].mean(0), "end_std_px": 2.0, "pixel_px": 1.0, **known}
    return SeenInstrument(mask, (240, 320), sides, evidence=1.0, **known)


def bars(*boxes: tuple[int, int, int, int], ground: int = 120) -> Image:
    """A grey picture of 320x240 px with dark bars, each from left to right and from above to below."""
    bgr = np.full((240, 320, 3), ground, np.uint8)
    for left, right, above, below in boxes:
        bgr[above:below, left:right] = 30
    return bgr


SHAFT, WRIST = (0, 200, 100, 140), (200, 280, 108, 132)


def silhouette(bgr: Image, seen: SeenInstrument, tool_fraction: float = 0.3) -> Silhouette | None:
    return find_silhouette(bgr, seen, None, WristShape(tool_fraction, 2.0), 12.0)


@pytest.mark.slow
def test_instruments_over_tissue():
    """Of each image alone: most of 16 pictures above 0.85, none below 0.6."""
    found = [iou(instruments(one.bgr), one.instruments > 0) for one in map(surgery_image, range(16))]
    assert np.median(found) > 0.88
    assert np.mean(np.array(found) > 0.85) >= 0.8
    assert min(found) > 0.6


@pytest.mark.slow
def test_bare_tissue_holds_no_instrument():
    """Vessels, fat, highlights, light that falls off and any border are no straight sides that come in."""
    counts = [len(auto_masks(surgery_image(seed, count=0).bgr).seen) for seed in range(24)]
    assert counts.count(0) >= 23


@pytest.mark.parametrize("border", BORDERS)
def test_the_picture_inside_its_border(border):
    """A border of any shape is found to a pixel or two, and is never shaft nor tissue."""
    for seed in range(3):
        one = surgery_image(seed, border=border)
        assert iou(picture_of(one.bgr) > 0, one.picture > 0) > 0.97
        masks = auto_masks(one.bgr)
        outside = cv2.dilate(one.picture, np.ones((9, 9), np.uint8)) == 0
        assert not (masks.shaft[outside] > 0).any()
        assert not (masks.tissue[outside] > 0).any()


@pytest.mark.parametrize("level", [0, 240, 255])
def test_an_image_of_one_level_is_all_picture(level):
    """The lens before a lamp, or covered: nothing is darker than the rest, and there is no instrument."""
    bgr = np.full((120, 160, 3), level, np.uint8)
    assert picture_of(bgr).all()
    assert not auto_masks(bgr).seen


def test_instruments_come_in_where_light_ends():
    """Between the black border and the light there is picture, too dark to show a shaft: none comes in behind it."""
    bgr = np.zeros((240, 320, 3), np.uint8)
    for axes, level in (((150, 110), 14), ((110, 80), 120)):
        cv2.ellipse(bgr, (160, 120), axes, 0.0, 0, 360, (level, level, level), cv2.FILLED)
    image = Evidence(bgr, AutoSettings())
    assert iou(image.picture > 0, bgr[..., 0] > 0) > 0.97
    assert iou(image.core > 0, cv2.erode(bgr[..., 0], np.ones((5, 5), np.uint8)) > 60) > 0.97


def test_the_end_is_between_that_of_edges_and_that_of_evidence():
    """A wrist as bright as what is behind it has no edges, sides of another go on: each counts as it is sure."""
    mask = bars((0, 230, 100, 140))[..., 0] == 30
    before, at_edges, beyond = (
        silhouette(bars(SHAFT), seen_as(mask, sides_of(230.0), end_px=np.array([end, 119.5]), end_std_px=std_px)).rim
        for end, std_px in ((170.0, 3.2), (200.0, 3.2), (230.0, 6.4))
    )
    assert at_edges.pixel[0] == pytest.approx(200.0, abs=1.0)
    assert before.pixel[0] == pytest.approx(185.0, abs=2.0)
    assert beyond.pixel[0] == pytest.approx(206.0, abs=2.0)
    assert at_edges.std_px < 3.2
    assert all(abs(rim.pixel[0] - 200.0) < 2.0 * rim.std_px for rim in (before, beyond))


@pytest.mark.parametrize("end", [180.0, 60.0], ids=["a shaft", "a short segment"])
def test_sides_that_are_mostly_the_wrist_s_leave_the_width_open(end):
    """A wrist in line with a short segment of the shaft may be narrower."""
    found = silhouette(bars(SHAFT), seen_as(bars(SHAFT)[..., 0] == 30, sides_of(end), ends_dark=True))
    assert found.wrist_std == (pytest.approx(0.19, abs=0.02) if end == 60.0 else 0.0)


def test_one_side_that_is_mostly_the_wrist_s_leaves_half_as_much_open():
    bgr = bars((0, 60, 100, 140), (60, 200, 100, 125))
    found = silhouette(bgr, seen_as(bgr[..., 0] == 30, sides_of(60.0), ends_dark=True))
    assert found.wrist_std == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("end", [200.0, 130.0], ids=["the end", "a band before it"])
def test_an_outline_longer_than_a_wrist_says_that_its_end_is_none(end):
    """Beyond a band the rest of the shaft looks like wrist: the tip is seen, and the end is as uncertain."""
    bgr = bars(SHAFT, WRIST)
    found = silhouette(bgr, seen_as(bgr[..., 0] == 30, sides_of(end), ends_dark=True))
    assert found.wrist.tip_px == pytest.approx([279.0, 119.5], abs=3.0)
    assert abs(found.rim.pixel[0] - 200.0) < 2.0 * found.rim.std_px
    assert found.rim.std_px < (5.0 if end == 200.0 else 45.0)


@pytest.mark.parametrize("touches", [False, True], ids=["alone", "touched"])
def test_of_two_wrists_that_touch_the_origin_is_in_either(touches):
    """The one of another instrument, as long as its own, begins where this one ends: alone, it is a part of it."""
    bgr = cv2.line(bars(SHAFT, WRIST), (205, 115), (240, 40), (30, 30, 30), 24)
    found = silhouette(bgr, seen_as(bgr[..., 0] == 30, sides_of(), touches_another=touches), 0.6)
    off_px = float(np.linalg.norm(found.wrist.pixel - [248.0, 119.5]))
    assert (off_px < 1.5 * found.wrist.std_px) is touches


@pytest.mark.parametrize(("wrist", "std"), [((), 0.3), ((WRIST,), 0.0)])
def test_beyond_a_wrist_that_was_taken_for_a_shaft_there_is_no_wrist(wrist, std):
    bgr = bars(SHAFT, *wrist)
    found = silhouette(bgr, seen_as(bgr[..., 0] == 30, sides_of(), wrist_std=0.3), 0.6)
    assert found.wrist_std == pytest.approx(std, abs=0.05)


def test_sides_run_along_the_outline():
    """Half of each side is within a pixel and a half of where the painted shaft ends, nine tenths within four."""
    off_px = []
    for one in map(surgery_image, range(6)):
        outline = cv2.Canny(one.instruments, 100, 200) == 0
        distance = cv2.distanceTransform(outline.astype(np.uint8), cv2.DIST_L2, 5)
        for seen in auto_masks(one.bgr).seen:
            share = np.linspace(0.1, 0.9, 20)[:, None]
            for start, end in seen.sides:
                x, y = np.rint(start + share * (end - start)).astype(int).T
                off_px.append(distance[y, x])
    assert len(off_px) >= 12
    assert np.median(np.median(off_px, axis=1)) < 1.5
    assert np.median(np.percentile(off_px, 90, axis=1)) < 4.0


def test_sides_without_an_edge_are_those_of_the_evidence():
    """In an image without edges a shaft's sides are as the evidence has them, and off by a few percent of the width."""
    told = 0
    for one in map(surgery_image, range(6)):
        for seen in auto_masks(one.bgr).seen:
            if silhouette(one.bgr, seen) is None:
                continue
            told += 1
            flat = silhouette(np.full_like(one.bgr, 120), seen)
            for edge in flat.edges:
                assert np.diag(edge.covariance).min() > (0.04 * flat.width_px) ** 2
    assert told >= 6


@pytest.mark.parametrize(("top", "is_edge"), [(101.5, True), (103.0, False)])
def test_an_edge_farther_from_the_evidence_than_that_is_rough_is_another_one_s(top, is_edge):
    """Evidence of half a picture's width is right to 3 px; letters and highlights have edges, too."""
    mask = bars(SHAFT)[..., 0] == 30
    upper, lower = silhouette(bars(SHAFT), seen_as(mask, sides_of(top=top))).edges
    assert lower.covariance is None
    assert (upper.covariance is None) is is_edge
    assert upper.start_px[1] == pytest.approx(99.5 if is_edge else top, abs=0.5)


@pytest.mark.parametrize("behind", [(110, 116, 124), (70, 70, 210)], ids=["grey", "red"])
@pytest.mark.parametrize("light", [1.0, 0.5, 0.25], ids=["sunlit", "shadow", "dark shadow"])
def test_the_shaft_ends_before_its_own_shadow(behind, light):
    """A shadow with a penumbra along a side is no part of the shaft, though the evidence has it for one."""
    half_lit = np.full((240, 320, 1), 1.0)
    half_lit[140:158] = light
    half_lit = cv2.GaussianBlur(half_lit, (0, 0), 3.0)[..., None]
    bgr = half_lit * np.array(behind)
    bgr[100:140, :200] = 35, 32, 32
    bgr = cv2.GaussianBlur(bgr, (0, 0), 0.8).astype(np.uint8)
    below = 139.5 if light == 1.0 else 157.5
    mask = bars((0, 200, 100, int(below + 0.5)))[..., 0] == 30
    found = silhouette(bgr, seen_as(mask, sides_of(bottom=below), pixel_px=2.0))
    assert found.width_px == pytest.approx(40.0, abs=0.7)


def stained_shaft(share: float, shaft_bgr: tuple[int, int, int] = (38, 35, 35)) -> Image:
    """A grey shaft in rows 100 to 140, its shadow as dark down to row 160; blood over a share of their border."""
    lit = np.ones((240, 320, 1), np.float32)
    lit[140:160, :280] = 0.45
    bgr = cv2.GaussianBlur(lit, (0, 0), 3.0)[..., None] * np.array((70.0, 76.0, 84.0))
    bgr[100:140, :280] = shaft_bgr
    for begin in range(0, 280, 40):
        bgr[124:140, begin : begin + round(40 * share)] = 10, 8, 60
    return np.asarray(cv2.GaussianBlur(bgr, (0, 0), 0.8), np.uint8)


def side(y: float, blur_px: float) -> EdgeLine:
    """A shaft's side along a row."""
    return EdgeLine(np.array([0.0, y]), np.array([280.0, y]), np.zeros((0, 2)), False, blur_px=blur_px)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_a_shaft_ends_at_its_shadow_by_colours_alone_with_blood_on_it(share):
    """Red is no colour of the shaft either, so that blood on its limb looks like more of what is beside it."""
    other = side(99.5, 0.8)
    found = edge_within(stained_shaft(share), side(158.0, 3.0), other, None, 12.0)
    assert [found.start_px[1], found.end_px[1]] == pytest.approx([139.5, 139.5], abs=1.0)
    lit = np.where(np.arange(240)[:, None, None] >= 140, np.uint8(160), stained_shaft(share))
    assert edge_within(lit, side(139.5, 3.0), other, None, 12.0) is None


@pytest.mark.parametrize("shaft_bgr", [(44, 36, 30), (26, 26, 26)], ids=["faint", "clear"])
def test_a_step_within_a_shadow_that_is_much_fainter_than_its_border_is_grain(shaft_bgr):
    """Of a shaft as dark as its shadow only colours say where that ends."""
    found = edge_within(stained_shaft(0.0, shaft_bgr), side(158.0, 3.0), side(99.5, 0.8), None, 6.0)
    assert (found.covariance is None) is (shaft_bgr == (26, 26, 26))


def test_the_dark_side_of_a_shaft_that_reflects_tissue_is_no_shadow():
    """Below row 128 it is bluer than tissue, and fades into that from row 140 on."""
    rows = np.clip((np.arange(240) - 140) / 40, 0.0, 1.0)[:, None, None]
    bgr = (1.0 - rows) * (44, 24, 36) + rows * (48, 60, 100) + np.zeros((1, 320, 1))
    bgr[:100] = 48, 60, 100
    bgr[100:128] = 38, 35, 35
    seen = seen_as(bars((0, 320, 100, 140))[..., 0] == 30, sides_of(end=319.0), end_std_px=np.inf)
    found = silhouette(cv2.GaussianBlur(bgr, (0, 0), 0.8).astype(np.uint8), seen)
    assert found.width_px == pytest.approx(40.0, abs=0.7)


def test_a_border_softer_than_the_other_side_is_that_of_a_shadow_as_grey_as_the_shaft():
    lit = np.full((240, 320, 3), 110.0)
    lit[140:160, :280] *= 0.45
    bgr = cv2.GaussianBlur(lit, (0, 0), 3.0)
    bgr[100:140, :280] = 48
    seen = seen_as(bars((0, 280, 100, 160))[..., 0] == 30, sides_of(end=280.0, bottom=159.5))
    upper, lower = silhouette(cv2.GaussianBlur(bgr, (0, 0), 0.8).astype(np.uint8), seen).edges
    assert upper.covariance is None
    assert np.sqrt(lower.covariance[0, 0]) > 5.0


@pytest.mark.parametrize("penumbra_px", [1.5, 0.0], ids=["shadow", "part of the shaft"])
def test_in_an_image_out_of_focus_a_shadow_is_hardly_softer_than_the_shaft(penumbra_px):
    """Blur hides what tells both apart; the shaft's own edge is within, as sharp as its other one, and the sharper one.

    A strip whose border is the sharper one is the shaft's limb, which reflects the ground.
    """
    bgr = np.full((240, 320, 3), (95.0, 105.0, 120.0))
    bgr[140:158, :280] *= 0.6
    if penumbra_px:
        bgr = cv2.GaussianBlur(bgr, (0, 0), penumbra_px)
    bgr[100:140, :280] = 62, 54, 50
    if not penumbra_px:
        bgr[136:144, :280] = cv2.blur(bgr[136:144, :280], (1, 8))
    seen = seen_as(bars((0, 280, 100, 158))[..., 0] == 30, sides_of(end=280.0, bottom=157.5))
    _, lower = silhouette(cv2.GaussianBlur(bgr, (0, 0), 2.2).astype(np.uint8), seen).edges
    assert lower.end_px[1] == pytest.approx(139.5 if penumbra_px else 157.5, abs=1.0)


@pytest.mark.parametrize("is_cap", [False, True], ids=["shadow", "cap"])
def test_a_side_that_goes_on_alone_is_doubtful_unless_the_instrument_does(is_cap):
    """A sharp shadow, as grey as the shaft, lies along one side and goes on beyond; a cap is as wide as the shaft."""
    bgr = np.full((240, 320, 3), 120.0)
    bgr[100:140, :200] = 55
    bgr[135:146, :280] = 25
    bgr[135:140, :200] = 55
    if is_cap:
        bgr[110:146, 200:280] = 200
    mask = bars((0, 280 if is_cap else 200, 100, 146))[..., 0] == 30
    seen = seen_as(mask, sides_of(bottom=145.5), ends_dark=True)
    upper, lower = silhouette(cv2.GaussianBlur(bgr, (0, 0), 0.8).astype(np.uint8), seen).edges
    assert lower.end_px[0] > 250.0
    assert upper.covariance is None
    assert (lower.covariance is None) is is_cap


def test_the_tip_of_what_touches_another_instrument_may_be_the_other_ones():
    """Jaws of two instruments meet in line: nothing shows where the first ends, at a straight wrist's length or so."""
    bgr = np.full((240, 320, 3), 170.0)
    bgr[100:140, :160] = 40
    bgr[110:130, 160:310] = 90
    mask = bars((0, 160, 100, 140), (160, 310, 110, 130))[..., 0] == 30
    seen = seen_as(mask, sides_of(160.0), touches_another=True)
    found = silhouette(cv2.GaussianBlur(bgr, (0, 0), 0.8).astype(np.uint8), seen)
    own_tip_px = np.array([160.0 + 2.0 * 40.0, 119.5])
    off_px = np.linalg.norm(found.wrist.tip_px - own_tip_px)
    assert 50.0 < off_px < 2.0 * found.wrist.tip_std_px


def test_a_wrist_that_comes_in_from_the_border_is_no_shaft(golden):
    """A wrist is half as wide as the shaft: taken for it, its depth would be twice as large."""
    images = [one.image_bgr for one in read_images(open_recording(golden / "3d" / "duo.mcap", PROFILE))]
    segmenter = make_segmenter(AutoSegmentation(method="auto"))

    def seen(frame: int) -> tuple[SeenInstrument, ...]:
        """Without the plates of tags, which stand out beside the shafts."""
        context = FrameContext(images[frame], segmenter, PROFILE)
        return context.masks_as_recorded.seen

    wrists, shafts = ([one for frame in frames for one in seen(frame)] for frames in ((20, 27), (3, 15)))
    assert [one.shows_shaft for one in wrists] == [False] * 2
    assert [one.shows_shaft for one in shafts] == [True] * 4
    assert [one.wrist_std for one in shafts] == [0.0] * 4
    assert [one.touches_another for frame in (0, 16) for one in seen(frame)] == [False, False, True]
    # Also those that touch have their own wrist and jaws, and not the other one's.
    assert min(np.count_nonzero(one.distal) for one in shafts) > 1000
    assert all(np.linalg.norm(one.tip_px - one.end_px) < 3.0 * one.width_px for one in shafts)
    assert silhouette(images[27], wrists[1]) is None


def test_instruments_without_a_straight_shaft_are_no_tissue():
    """What hangs in the middle of a picture comes in from nowhere: there is no shaft to measure, but no tissue."""
    covered = []
    for seed in range(6):
        one, bare = surgery_image(seed, count=1), surgery_image(seed, count=0)
        inner = cv2.erode(one.picture, np.ones((91, 91), np.uint8), borderValue=0) > 0
        floating = inner & (one.instruments > 0)
        masks = auto_masks(np.where(floating[..., None], one.bgr, bare.bgr))
        if masks.seen or np.count_nonzero(floating) < 0.01 * floating.size:
            continue
        covered.append(float((masks.instrument[floating] > 0).mean()))
        assert not (masks.tissue & masks.instrument).any()
    assert len(covered) >= 3
    assert np.median(covered) > 0.7


def test_a_shaft_that_is_no_evidence_near_the_border_comes_in_there():
    """In a dark corner the network sees none of it for a while."""
    image, odds = Evidence(bars(SHAFT), AutoSettings()), np.full((2, 240, 320), -2.0, np.float32)
    odds[:, 100:140, :30], odds[:, 100:140, 30:200] = -1.0, 3.0
    image.scores, image.odds = odds, odds[0]
    (found,) = find_instruments(image)
    assert found.entry_px[0] < 4.0
    assert found.end_px[0] == pytest.approx(200.0, abs=3.0)
    assert iou(found.small_mask, bars(SHAFT)[..., 0] == 30) > 0.9


def is_accepted(bgr: Image, top: int) -> bool:
    """Whether what the network takes for an instrument, from a row down to row 140, has a shaft's outline."""
    image, odds = Evidence(bgr, AutoSettings()), np.full((2, 240, 320), -2.0, np.float32)
    odds[:, top:140, :200] = 3.0
    image.scores, image.odds = odds, odds[0]
    return outline_score(Outline(sides_of(199.5, top - 0.5)), image) > 0.0


@pytest.mark.parametrize(("first_side", "is_shaft"), [(80, False), (100, True)])
def test_a_cable_beside_a_shaft_is_no_part_of_it(first_side, is_shaft):
    """Where the network takes both for one, most inside of the outline's side has the colours beyond it."""
    levels = np.full(240, 120.0)
    levels[80:100], levels[100:140], levels[112:118] = 150.0, 40.0, 230.0  # cable, shaft, and light on it
    bgr = np.repeat(np.repeat(levels[:, None], 320, axis=1)[..., None], 3, axis=2).astype(np.uint8)
    bgr[:, 200:] = 120
    assert is_accepted(bgr, first_side) is is_shaft


def test_lettering_is_a_part_of_the_shaft():
    """Beside white letters a dark side looks like dark tissue, but the shaft between the letters looks like it, too."""
    bgr = bars(ground=64)
    bgr[100:140, :200] = np.linspace(54.0, 30.0, 40)[:, None, None]  # shaded across
    for x in range(0, 190, 16):
        bgr[119:122, x : x + 13] = 230
    assert is_accepted(bgr, 100)


def test_highlights_at_the_border_are_no_instruments():
    """A ragged patch of glare is long, bright and without colour, as steel is, but has no straight sides: 5 of 6."""
    counts = []
    for seed in range(3, 9):
        rng = np.random.default_rng(seed)
        bgr = surgery_image(seed, count=0, border="none").bgr
        for x in range(0, 260, 6):
            centre = (x, int(240 + 0.2 * x + rng.normal(0.0, 9.0)))
            axes = (int(rng.integers(4, 12)), int(rng.integers(4, 16)))
            cv2.ellipse(bgr, centre, axes, float(rng.uniform(0, 180)), 0, 360, (250, 248, 252), cv2.FILLED)
        counts.append(len(auto_masks(np.asarray(cv2.GaussianBlur(bgr, (0, 0), 1.0), np.uint8)).seen))
    assert counts.count(0) >= 5


@pytest.mark.parametrize("leaves", [True, False], ids=["leaves", "ends"])
def test_the_end_of_a_shaft_that_leaves_a_round_view_at_a_slant_is_not_visible(leaves):
    """One side leaves the view before the other: that says nothing of where the shaft ends."""
    bgr = np.zeros((240, 320, 3), np.uint8)
    cv2.circle(bgr, (160, 120), 115, (120, 120, 120), cv2.FILLED)
    along = np.linspace(0.0, 240.0 if leaves else 150.0, 300)
    x, y = np.round([40.0 + 0.985 * along, 60.0 + 0.174 * along]).astype(int)
    shaft = np.zeros((240, 320), np.uint8)
    cv2.line(shaft, (int(x[0]), int(y[0])), (int(x[-1]), int(y[-1])), 255, 40)
    if not leaves:
        shaft[:, 190:] = 0
    bgr[(shaft > 0) & (bgr[..., 0] > 0)] = 30
    image = Evidence(bgr, AutoSettings())
    image.scores = np.tile(np.where(shaft > 0, 3.0, -2.0).astype(np.float32), (2, 1, 1))
    found = find_instruments(image)[0]
    assert np.isfinite(found.end_std_px) != leaves
    if not leaves:
        assert found.end_px[0] == pytest.approx(190.0, abs=4.0)


@pytest.mark.parametrize("both", [True, False], ids=["both edges end", "one edge ends"])
def test_a_shaft_that_goes_on_to_the_border_ends_only_where_both_edges_do(both):
    bgr = bars(SHAFT, *() if both else [(200, 320, 100, 120)])
    found = silhouette(bgr, seen_as(bars((0, 320, 100, 140))[..., 0] == 30, sides_of(319.0), end_std_px=np.inf))
    assert (found.rim is not None) == both
    if both:
        assert found.rim.pixel[0] == pytest.approx(200.0, abs=2.0)


@pytest.mark.parametrize(("dark_px", "collar_m", "shows"), [(24, 0.0, False), (80, 0.0, True), (24, 0.007, True)])
def test_behind_a_short_segment_of_a_shaft_the_sides_are_those_of_the_wrist(dark_px, collar_m, shows):
    """Unless a wrist's body is as wide as the shaft: what is in view beyond the segment is measured all the same."""
    bgr, shaft, wrist = np.full((240, 320, 3), 120, np.uint8), *np.zeros((2, 240, 320), np.uint8)
    shaft[100:140, :dark_px] = 1
    cone = np.array(
        [[dark_px, 100], [dark_px + 50, 108], [dark_px + 90, 110], [dark_px + 90, 130], [dark_px + 50, 132]]
    )
    cv2.fillConvexPoly(wrist, np.vstack([cone, [[dark_px, 139]]]).astype(np.int32), 1)
    bgr[wrist > 0], bgr[shaft > 0] = 200, 30
    image = Evidence(bgr, AutoSettings())
    image.scores = np.where(np.stack([shaft | wrist, shaft]) > 0, 3.0, -2.0).astype(np.float32)
    sizes = {"shaft_end_m": 0.004, "outline_end_m": collar_m - 0.004}
    model = ShaftSizes(PROFILE.instrument.model_copy(update=sizes), 0.009)
    (found,) = find_instruments(image)
    assert model.with_likelier_end(found, 2e-4).shows_shaft == shows
