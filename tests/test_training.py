"""The pictures that the segmentation network is trained on, with exact labels; public sets with masks."""

import json
import sys

import cv2
import numpy as np
import pytest

from benchmarks.masks import OUTLINES, PANEL_SIZE, filled, iou, panels
from tests.conftest import REPOSITORY
from training import pictures, train
from training.instruments import DISTAL, INSTRUMENT, NO_INSTRUMENT, OTHER, SHAFT, TISSUE, UNKNOWN
from training.parts import Part, draw
from training.pictures import augmented, near_keypoints
from training.scene import HEIGHT, WIDTH, layers, render, rendered

SIZE = (150, 200)
WHITE = np.full((2, 2, 3), 255.0, np.float32)


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
    """Also pictures without instruments; keypoints are on instruments, but for those that another one hides."""
    pictures = [render(seed) for seed in range(40)]
    for one, two in zip(pictures[7], render(7), strict=True):
        np.testing.assert_array_equal(one, two)
    labels = [labels for _, labels, _ in pictures]
    assert {int(c) for each in labels for c in np.unique(each)} == {OTHER, TISSUE, DISTAL, SHAFT, INSTRUMENT}
    assert 0.6 <= np.mean([bool((each >= DISTAL).any()) for each in labels]) < 1.0
    on = [
        cv2.dilate(each, np.ones((5, 5), np.uint8))[round(float(y)), round(float(x))] >= DISTAL
        for _, each, points in pictures
        for x, y in points[np.isfinite(points[..., 0])].clip(0, (WIDTH - 1, HEIGHT - 1))
    ]
    assert len(on) > 100
    assert np.mean(on) > 0.95
    for seed in range(5):
        assert layers(np.random.default_rng(seed), SIZE, count=0)[1].max() <= TISSUE


@pytest.mark.parametrize("seed", range(4))
def test_labels_and_keypoints_move_with_the_picture(seed):
    """A bright disc, labelled, with a tip in its middle, at another size: all three stay together."""
    middle, points = np.array([190.0, 140.0]), np.full((5, 5, 2), np.nan, np.float32)
    points[0, 3] = middle
    label = cv2.circle(np.zeros((HEIGHT, WIDTH), np.uint8), (190, 140), 30, SHAFT, cv2.FILLED)
    image = np.repeat(80 * label[..., None], 3, -1)
    seen, classes, moved = augmented(np.random.default_rng(seed), image, label, points, (192, 256))
    centre = np.argwhere(classes == SHAFT).mean(0)[::-1]
    assert seen[classes == SHAFT].mean() > 100
    assert seen[classes == OTHER].mean() < 50
    np.testing.assert_allclose(moved[0, 3], centre, atol=0.6)
    assert np.isnan(moved).sum() == moved.size - 2
    tips = near_keypoints(moved, (192, 256))
    np.testing.assert_allclose(np.argwhere(tips[3]).mean(0)[::-1], (centre + 0.5) / 2 - 0.5, atol=0.6)
    assert not tips[:3].any()


def test_outlines_become_labels_of_real_pictures(tmp_path, monkeypatch):
    """Instrument inside, open beside an outline and in doubt; every outlined repository has a licence in the docs."""
    marked = [[[100, 400, 900, 400, 900, 600, 100, 600]], [[0, 0, 200, 0, 200, 200, 0, 200]]]
    own = {"set": {"one.png": {"shows": "tissue", "outlines": marked}, "two.png": {"shows": "room"}}}
    (tmp_path / "outlines.json").write_text(json.dumps(own), "utf-8")
    known = json.loads(pictures.OUTLINES.read_text("utf-8"))
    page = (REPOSITORY / "docs" / "real-data.md").read_text("utf-8")
    assert all(name in page for name in known)
    monkeypatch.setattr(pictures, "OUTLINES", tmp_path / "outlines.json")
    (tmp_path / "set").mkdir()
    for name in own["set"]:
        shown = np.full((300, 400, 3), (60, 60, 180), np.uint8)
        cv2.imwrite(str(tmp_path / "set" / name), cv2.rectangle(shown, (40, 120), (360, 180), (40, 40, 40), -1))
    real = pictures.outlined([tmp_path / "set"])
    (first, labels), (second, others) = real
    assert first[labels == INSTRUMENT].max() < 60
    assert first[labels == TISSUE][:, 2].min() > 150
    assert (labels == INSTRUMENT).mean() == pytest.approx(0.16, abs=0.03)
    assert (labels[:50, :70] == UNKNOWN).all()
    assert (others == OTHER).all()
    assert second.shape == (HEIGHT, WIDTH, 3)
    shown, rng, sizes = pictures.Shown(rendered(1, 3), real), np.random.default_rng(0), []  # none has a tag
    for _ in range(30):
        image, label, _, is_drawn = shown.sample(rng, (192, 256))
        assert not (is_drawn and (label >= INSTRUMENT).any())
        sizes.append((image.shape, label.shape))
    assert set(sizes) == {((192, 256, 3), (192, 256))}


def test_grey_pictures_with_masks_get_the_colours_of_tissue(tmp_path):
    """Each is read once; the instrument stays about as grey as it was, what is around it does not."""
    folder = tmp_path / "TransUNet-single" / "datasets" / "set" / "Training"
    own = cv2.rectangle(np.zeros((320, 470), np.uint8), (100, 0), (200, 319), 255, cv2.FILLED)
    for name in ("Grayscale Image 1.png", "Grayscale Image 2.png"):
        for kind, image in (("Grayscale", own // 4 + 90), ("Masks", own)):
            named = name.replace("Grayscale Image", "Mask") if kind == "Masks" else name
            path = folder / kind / "all" / named
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)
    grey = pictures.masked([tmp_path])
    ((image, labels),) = grey
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert (labels == INSTRUMENT).mean() == pytest.approx(100 / 470, abs=0.02)
    assert pictures.masked([tmp_path / "none"]) == []
    shown, rng, warm = pictures.Shown(rendered(0, 3), grey, grey), np.random.default_rng(0), []
    for _ in range(60):
        image, label, _, _ = shown.sample(rng, (192, 256))
        if not np.isin(label, (DISTAL, SHAFT)).any() and (label == INSTRUMENT).any():
            redness = image[..., 2] - image[..., 0].astype(float)
            around = (label == NO_INSTRUMENT) & (image.max(2) > 20)
            warm.append(redness[around].mean() - redness[label == INSTRUMENT].mean())
    assert np.percentile(warm, 95) > 10


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
    assert train.main([str(tmp_path / "net.onnx")]) == 1
    assert "is not installed: pip install torch" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert (REPOSITORY / "svmdist" / "models" / "instruments.onnx").is_file()
