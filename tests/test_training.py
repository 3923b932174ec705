"""The pictures that the segmentation network is trained on, with exact labels; public sets with masks."""

import json
import sys

import cv2
import numpy as np
import pytest

from benchmarks.masks import OUTLINES, PANEL_SIZE, filled, panels
from tests.conftest import REPOSITORY
from training import train
from training.instruments import DISTAL, OTHER, SHAFT, TISSUE, Material, Part, draw
from training.scene import augmented, halved, iou, layers, render

SIZE = (150, 200)
WHITE = Material(np.full(3, 255.0, np.float32), np.ones(4), np.ones(3), 1.0, ())
"""Lit alike everywhere: what is drawn in it shows how much of each pixel it covers."""


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 2.5])
def test_a_part_is_labelled_where_it_covers_half_of_a_pixel(angle):
    """Against its outline's geometry: centres inside are labelled, and none farther out than rounding allows."""
    middle, along = np.array([100.3, 74.8]), np.array([np.cos(angle), np.sin(angle)])
    part = Part(middle - 50 * along, middle + 40 * along, 12.0, 8.0, SHAFT, WHITE)
    canvas, labels = np.zeros((*SIZE, 3), np.float32), np.full(SIZE, TISSUE, np.uint8)
    draw(canvas, labels, [part])
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    offset = np.stack([x, y], -1) - part.begin
    t = offset @ along / 90.0
    to_side = 12.0 - 4.0 * t - np.abs(offset @ np.array([-along[1], along[0]]))  # inwards, in px
    to_end = 90.0 * np.minimum(t, 1.0 - t)
    labelled = labels == SHAFT
    corner = (np.abs(to_side) < 0.5) & (np.abs(to_end) < 0.5)  # less than half is covered there
    inwards = np.minimum(to_side, to_end)
    assert labelled[(inwards > 0.01) & ~corner].all()
    assert not labelled[inwards < -0.01].any()
    assert labelled.sum() == pytest.approx(90.0 * (12.0 + 8.0), rel=0.01)


def test_pictures_follow_from_the_seed_and_have_all_classes():
    """Also pictures without instruments; what is black outside of the picture is no tissue."""
    pictures = [render(seed) for seed in range(40)]
    for one, two in zip(pictures[7], render(7), strict=True):
        np.testing.assert_array_equal(one, two)
    labels = [labels for _, labels in pictures]
    assert {int(c) for each in labels for c in np.unique(each)} == {OTHER, TISSUE, DISTAL, SHAFT}
    assert 0.6 <= np.mean([bool((each >= DISTAL).any()) for each in labels]) < 1.0
    for seed in range(5):
        assert layers(np.random.default_rng(seed), SIZE, count=0)[1].max() <= TISSUE


def test_what_is_flipped_keeps_its_labels():
    """A picture whose brightness is its label: after flips each pixel still has its own."""
    labels = np.random.default_rng(0).integers(0, 4, (8, 6, 10)).astype(np.uint8)
    images = np.repeat(40 + 50 * labels[..., None], 3, -1)
    for image, label in zip(*augmented(np.random.default_rng(1), images, labels), strict=True):
        assert max(image[label == number].std(axis=0).max() for number in range(4)) < 1e-9
    small, classes = halved(images, labels)
    np.testing.assert_array_equal(classes, labels[:, ::2, ::2])
    np.testing.assert_array_equal(small[0, 0, 0], images[0, :2, :2].mean((0, 1)).astype(np.uint8))


def test_masks_of_public_sets(tmp_path):
    """Outlines are filled with the pixels on them; a panel's mask has both instruments' colours."""
    square = filled([[[2.0, 3.0], [8.0, 3.0], [8.0, 9.0], [2.0, 9.0]]], (12, 12))
    assert square.sum() == 49
    assert square[3:10, 2:9].all()
    for frames in json.loads(OUTLINES.read_text("utf-8")).values():
        assert all(filled(outlines, (576, 720)).any() == bool(outlines) for outlines in frames.values())
    height, width = PANEL_SIZE
    panel = np.zeros((height, 3 * width, 3), np.uint8)
    panel[50:90, width + 10 : width + 60] = (233, 180, 86)
    panel[90:95, width + 10 : width + 60] = (139, 139, 0)
    panel[200:, width:] = (60, 20, 220)
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "one_panel.png"), panel)
    ((_, mask),) = panels(tmp_path)
    assert mask.sum() == 45 * 50
    assert iou(mask, mask[::-1]) < iou(mask, mask) == 1.0


def test_training_without_pytorch_is_one_line(tmp_path, monkeypatch, capsys):
    """PyTorch is no dependency: who lacks it is told what to install, and nothing is drawn or written."""
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "training.network", raising=False)
    assert train.main([str(tmp_path / "net.onnx"), "--cache", str(tmp_path / "cache")]) == 1
    assert "torch is not installed" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert (REPOSITORY / "svmdist" / "models" / "instruments.onnx").is_file()
