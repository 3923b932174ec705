"""Training pictures on disk, masks of public sets, and the layout that a profile needs to run the network."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.masked_sets import OUTLINES, PANEL_SIZE, SETS, filled
from benchmarks.overlap import iou, union_ious
from svmdist.vision.network import OnnxSegmenter, network_input
from tests.onnx_file import write_classifier
from training import dataset, train
from training.dataset import VALIDATION_SEED, augmented, halved, rendered
from training.instruments import DISTAL, SHAFT, TISSUE
from training.layout import network_rules
from training.scene import HEIGHT, MIDDLE, WIDTH, render


def test_pictures_are_drawn_once_and_the_same_by_several_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = rendered(VALIDATION_SEED, 3, tmp_path / "one")
    several = rendered(VALIDATION_SEED, 3, tmp_path / "two", processes=2)
    np.testing.assert_array_equal(made.images, several.images)
    np.testing.assert_array_equal(made.labels, several.labels)
    np.testing.assert_array_equal(made.images[2], render(VALIDATION_SEED + 2)[0])
    monkeypatch.setattr(dataset, "_many", lambda seeds, processes: pytest.fail("drawn again"))
    np.testing.assert_array_equal(rendered(VALIDATION_SEED, 3, tmp_path / "one").labels, made.labels)


def test_what_is_flipped_keeps_its_labels() -> None:
    """A picture whose brightness is its label: after flips each pixel still has its own."""
    labels = np.random.default_rng(0).integers(0, 4, (8, 6, 10)).astype(np.uint8)
    images = np.repeat(40 + 50 * labels[..., None], 3, -1)
    shown, told = augmented(np.random.default_rng(1), images, labels)
    for image, label in zip(shown, told, strict=True):
        means = [image[label == number].mean() for number in range(4)]
        assert max(image[label == number].std(axis=0).max() for number in range(4)) < 1e-9
        assert means == sorted(means)
    assert (told != labels).any()
    small, classes = halved(images, labels)
    assert small.shape == (8, 3, 5, 3)
    np.testing.assert_array_equal(classes, labels[:, ::2, ::2])
    np.testing.assert_array_equal(small[0, 0, 0], images[0, :2, :2].mean((0, 1)).astype(np.uint8))


def test_overlap_is_that_of_the_union_of_instruments() -> None:
    truth = np.array([[[TISSUE, DISTAL, SHAFT, SHAFT]], [[TISSUE, TISSUE, TISSUE, TISSUE]]], np.uint8)
    found = np.array([[[DISTAL, SHAFT, DISTAL, TISSUE]], [[TISSUE, SHAFT, TISSUE, TISSUE]]], np.uint8)
    assert union_ious(found, truth).tolist() == [0.5]  # 2 of 4; the second has no instrument
    assert iou(np.zeros(3, bool), np.zeros(3, bool)) == 1.0


def test_the_layout_is_what_a_profile_runs(tmp_path: Path) -> None:
    """A network of that input gives all three masks; pixels come as -1 to 1 in BGR."""
    weights = np.zeros((4, 3))
    weights[SHAFT, 0], weights[TISSUE, 2] = 1.0, 1.0  # blue is shaft, red is tissue
    model = write_classifier(tmp_path / "net.onnx", weights, np.zeros(4), (WIDTH, HEIGHT))
    rules = network_rules(model)
    image = np.zeros((96, 128, 3), np.uint8)
    image[:, :64], image[:, 64:] = (255, 0, 0), (0, 0, 255)
    masks = OnnxSegmenter(rules).masks(image)
    assert masks.shaft is not None
    assert (masks.shaft[:, :60] == 255).all()
    assert (masks.tissue[:, 68:] == 255).all()
    given = network_input(image, rules)
    assert given.shape == (1, 3, HEIGHT, WIDTH)
    assert given[0, 0, 0, 0] == pytest.approx((255 - MIDDLE) / MIDDLE)
    assert given.min() == pytest.approx(-1.0)


def test_outlines_are_filled_and_lie_about_their_images() -> None:
    square = filled([[[2.0, 3.0], [8.0, 3.0], [8.0, 9.0], [2.0, 9.0]]], (12, 12))
    assert square.sum() == 49  # pixels on the outline belong to it
    assert square[3:10, 2:9].all()
    for frames in json.loads(OUTLINES.read_text("utf-8")).values():
        for outlines in frames.values():
            assert all(len(outline) >= 8 for outline in outlines)
            mask = filled(outlines, (576, 720))
            assert mask.mean() < 0.3
            assert mask.any() == bool(outlines)


def test_sets_are_read_from_folders_of_their_repositories(tmp_path: Path) -> None:
    """A panel of three pictures, as one of the sets has them: the image, and both instruments' colours as the mask."""
    panels = next(each for each in SETS if each.name == "CholecSeg8k")
    assert all(each.images(tmp_path) == [] for each in SETS)
    height, width = PANEL_SIZE
    panel = np.zeros((height, 3 * width, 3), np.uint8)
    panel[:, :width] = 90
    panel[50:90, width + 10 : width + 60] = (233, 180, 86)
    panel[90:95, width + 10 : width + 60] = (139, 139, 0)
    panel[200:, width:] = (60, 20, 220)
    folder = tmp_path / "cholecseg8k-deeplabv3" / "images"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "one_panel.png"), panel)
    (read,) = panels.images(tmp_path)
    assert (read.bgr == 90).all()
    assert read.instruments.shape == read.bgr.shape[:2]
    assert read.instruments.sum() == 45 * 50
    assert read.instruments[50:95, 10:60].all()


def test_training_without_pytorch_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """PyTorch is no dependency: who lacks it is told what to install, and nothing is drawn or written."""
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "training.training", raising=False)
    monkeypatch.delitem(sys.modules, "training.network", raising=False)
    assert train.main([str(tmp_path / "net.onnx"), "--cache", str(tmp_path / "cache")]) == 1
    said = capsys.readouterr()
    assert "torch is not installed; training needs it: pip install torch" in said.err
    assert said.err.count("\n") == 1
    assert not list(tmp_path.iterdir())
