"""The network that ships: a profile names it, its layout is the one it was trained with, and it finds instruments."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.masks import instruments_of
from svmdist.errors import ProfileError
from svmdist.models import INSTRUMENTS, SHIPPED, shipped_file
from svmdist.profile import OnnxSegmentation, load_profile
from svmdist.vision.network import LEAST_AREA, OnnxSegmenter, network_input, parts_from_border
from tests.surgery_images import surgery_image
from training.dataset import iou
from training.instruments import DISTAL, SHAFT, TISSUE
from training.scene import HEIGHT, MIDDLE, WIDTH, layers

NAMED = '[segmentation]\nmethod = "onnx"\nmodel = "svmdist:{}"\n'


@pytest.fixture(scope="module")
def segmenter() -> OnnxSegmenter:
    return OnnxSegmenter(OnnxSegmentation.model_validate({"method": "onnx", "model": "svmdist:instruments"}))


def profile_with(folder: Path, segmentation: str) -> Path:
    """The profile of the dVRK arm with another segmentation."""
    text = load_text("dvrk-psm")
    head, _, rest = text.partition("[segmentation")
    tail = rest[rest.index("\n[") + 1 :]
    while tail.startswith("[segmentation"):
        tail = tail[tail.index("\n[") + 1 :]
    path = folder / "mine.toml"
    path.write_text(head + segmentation + "\n" + tail, "utf-8")
    return path


def load_text(name: str) -> str:
    import svmdist.profiles

    return (Path(svmdist.profiles.__file__).parent / f"{name}.toml").read_text("utf-8")


def test_a_profile_names_it_and_nothing_else(tmp_path: Path) -> None:
    """From any folder; and what the profile says besides comes before what ships."""
    rules = load_profile(profile_with(tmp_path, NAMED.format("instruments"))).segmentation
    assert isinstance(rules, OnnxSegmentation)
    assert rules.model == shipped_file("instruments")
    assert rules.from_border
    changed = load_profile(
        profile_with(tmp_path, NAMED.format("instruments") + "from_border = false\n")
    ).segmentation
    assert isinstance(changed, OnnxSegmentation)
    assert not changed.from_border
    assert changed.shaft == rules.shaft


def test_an_unknown_name_is_one_line_with_the_choices(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"no such network ships: .*svmdist:instruments") as caught:
        load_profile(profile_with(tmp_path, NAMED.format("instrument")))
    assert "\n" not in str(caught.value)


def test_its_layout_is_that_of_its_training() -> None:
    """Classes, size and levels of the pictures that it was trained on, and a file of at most 4 MiB."""
    assert (INSTRUMENTS["width_px"], INSTRUMENTS["height_px"]) == (WIDTH, HEIGHT)
    assert INSTRUMENTS["channels"] == "bgr"
    assert set(INSTRUMENTS["mean"]) == {MIDDLE}
    assert INSTRUMENTS["scale"] == pytest.approx(1 / MIDDLE)
    classes = [INSTRUMENTS[part]["class_ids"] for part in ("tissue", "instrument", "shaft")]
    assert classes == [(TISSUE,), (DISTAL,), (SHAFT,)]
    for name in SHIPPED:
        assert shipped_file(name).stat().st_size <= 4 << 20


def test_it_finds_instruments_in_pictures_of_another_renderer(segmenter: OnnxSegmenter) -> None:
    """IoU of the union of instruments over tissue, mean of 12 pictures that the tests of `auto` are drawn with."""
    ious = []
    for seed in range(12):
        drawn = surgery_image(7000 + seed)
        ious.append(iou(instruments_of(segmenter, drawn.bgr), drawn.instruments > 0))
    assert np.mean(ious) >= 0.88


def test_bare_tissue_has_no_instrument(segmenter: OnnxSegmenter) -> None:
    """Of 30 scenes without any, at most 1 % of the picture is taken for one in the mean, and nothing in most."""
    parts = []
    for seed in range(30):
        scene = layers(np.random.default_rng(50_000_000 + seed), (240, 320), count=0)
        image = np.clip(scene.bgr, 0, 255).astype(np.uint8)
        image[scene.picture == 0] = 0
        parts.append(instruments_of(segmenter, image).mean())
    assert np.mean(parts) <= 0.01
    assert np.mean(np.array(parts) == 0.0) >= 0.7


def test_masks_do_not_depend_on_the_number_of_threads(segmenter: OnnxSegmenter) -> None:
    """OpenCV shares a network's work between threads; scores stay the same to rounding."""
    image = surgery_image(7100).bgr
    before = cv2.getNumThreads()
    scores = []
    try:
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            net = cv2.dnn.readNetFromONNX(str(shipped_file("instruments")))
            rules = OnnxSegmentation.model_validate({"method": "onnx", "model": "svmdist:instruments"})
            net.setInput(network_input(image, rules))
            scores.append(net.forward())
    finally:
        cv2.setNumThreads(before)
    assert scores[0].shape == (1, 4, HEIGHT // 2, WIDTH // 2)
    np.testing.assert_allclose(scores[0], scores[1], atol=1e-3)


def test_parts_that_do_not_reach_the_border_are_left_out() -> None:
    """The image's own edge is border, a black one too, and what is small is nothing wherever it is."""
    black, mask = np.zeros((200, 300), np.uint8), np.zeros((200, 300), np.uint8)
    black[:, :40] = 255
    mask[20:50, 30:120] = 255  # reaches the black border, and lies over it in part
    mask[60:90, 200:300] = 255  # reaches the image's edge
    mask[120:150, 120:180] = 255  # lies in the middle
    mask[180:184, 40:44] = 255  # a fragment at the border
    assert LEAST_AREA * 200 * 260 > 16
    kept = parts_from_border(mask, black)
    assert kept[20:50, 45:120].all()
    assert kept[60:90, 200:].all()
    assert not kept[100:].any()
    assert not kept[:, :38].any()  # no instrument is seen where there is no picture
    assert not parts_from_border(np.zeros_like(mask), black).any()
    assert not parts_from_border(mask, np.full_like(black, 255)).any()  # a picture that is all black
