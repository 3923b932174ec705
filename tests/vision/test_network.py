"""Segmentation by a network: masks against an independent computation, and every fault of a profile in a line."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import ProfileError
from svmdist.profile import ClassRegion, OnnxSegmentation
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.network import OnnxSegmenter
from tests.onnx_file import node, tensor, value_info, write_classifier, write_model

WEIGHTS = np.array([[0.0, 0.0, 0.0], [1.0, -0.8, -0.1], [-1.0, 0.4, 0.7], [-0.5, -0.6, -0.4]])
BIAS = np.array([0.02, 0.0, -0.01, 0.45])
IMAGE = np.random.default_rng(3).integers(0, 256, (48, 64, 3)).astype(np.uint8)


def rules(model: Path, size: tuple[int, int] = (64, 48), **changes: object) -> OnnxSegmentation:
    """Class 1 is tissue, 2 the instrument's part, 3 the shaft."""
    parts = {
        name: ClassRegion(class_ids=(number,), min_area_px=10)
        for number, name in enumerate(("tissue", "instrument", "shaft"), 1)
    }
    values = {"method": "onnx", "model": model, "width_px": size[0], "height_px": size[1], **parts, **changes}
    return OnnxSegmentation.model_validate(values)


def scores_of(image_rgb: np.ndarray, mean: object = 0.0, scale: object = 1 / 255) -> np.ndarray:
    """The convolution without OpenCV: shape (h, w, C)."""
    return ((image_rgb - np.array(mean)) * np.array(scale)) @ WEIGHTS.T + BIAS


def enlarged(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear interpolation with pixel centres at whole numbers, of shape (h, w, C), by its definition."""
    for axis, length in ((0, height), (1, width)):
        count = values.shape[axis]
        at = np.clip((np.arange(length) + 0.5) * count / length - 0.5, 0, count - 1)
        low = np.minimum(at.astype(int), count - 2)
        part = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        values = np.take(values, low, axis) * (1 - part) + np.take(values, low + 1, axis) * part
    return values


@pytest.mark.parametrize("labels", ["", "keep", "drop"])
def test_masks_are_those_of_the_highest_score(tmp_path: Path, labels: str) -> None:
    """Scores and both shapes of labels give, pixel for pixel, the class that NumPy finds."""
    model = write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (64, 48), labels=labels)
    masks = OnnxSegmenter(rules(model)).masks(IMAGE)
    best = scores_of(IMAGE[..., ::-1]).argmax(-1)
    for number, mask in enumerate((masks.tissue, masks.instrument, masks.shaft), 1):
        assert mask is not None
        assert mask.dtype == np.uint8
        np.testing.assert_array_equal(mask, np.where(best == number, 255, 0))
        assert mask.any()


def test_channels_mean_and_scale_are_those_of_the_profile(tmp_path: Path) -> None:
    model = write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (64, 48))
    mean, scale = (120.0, 110.0, 100.0), (0.01, 0.02, 0.005)
    chosen = rules(
        model, channels="bgr", mean=mean, scale=scale, tissue={"class_ids": [1, 3], "min_area_px": 5}
    )
    best = scores_of(IMAGE, mean, scale).argmax(-1)
    np.testing.assert_array_equal(OnnxSegmenter(chosen).masks(IMAGE).tissue > 0, np.isin(best, [1, 3]))


def test_coarse_scores_are_interpolated_to_the_image(tmp_path: Path) -> None:
    """A network of 8x8 px for an image of 64x48: borders run where interpolated scores are equal, not in steps."""
    image = cv2.resize(IMAGE[:8, :8], (64, 48), interpolation=cv2.INTER_NEAREST)
    model = write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (8, 8))
    masks = OnnxSegmenter(rules(model, (8, 8))).masks(image)
    scores = enlarged(scores_of(IMAGE[:8, :8, ::-1]), 48, 64)
    first, second = np.sort(scores, -1)[..., -1], np.sort(scores, -1)[..., -2]
    clear = first - second > 1e-4  # float32 may break a tie otherwise
    assert clear.mean() > 0.99
    np.testing.assert_array_equal((masks.tissue > 0)[clear], (scores.argmax(-1) == 1)[clear])
    # An output coarser than its input says the same of every image: its own resolution does not matter.
    strided = write_classifier(tmp_path / "strided.onnx", WEIGHTS, BIAS, (64, 48), strides=(6, 8))
    np.testing.assert_array_equal(
        OnnxSegmenter(rules(strided)).labels(image), OnnxSegmenter(rules(model, (8, 8))).labels(image)
    )


def test_coarse_labels_are_enlarged_as_they_are(tmp_path: Path) -> None:
    """No class lies between two others: labels are repeated, never interpolated."""
    image = cv2.resize(IMAGE[:8, :8], (64, 48), interpolation=cv2.INTER_NEAREST)
    model = write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (8, 8), labels="keep")
    best = scores_of(IMAGE[:8, :8, ::-1]).argmax(-1)
    np.testing.assert_array_equal(
        OnnxSegmenter(rules(model, (8, 8))).labels(image), best.repeat(6, 0).repeat(8, 1)
    )


def test_the_network_runs_once_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often, and at whichever exposure, an image's masks are asked for; a network sees it as recorded."""
    segmenter = OnnxSegmenter(rules(write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (64, 48))))
    seen: list[np.ndarray] = []
    label = segmenter.labels
    monkeypatch.setattr(segmenter, "labels", lambda image: seen.append(image) or label(image))
    left, right = FrameContext(IMAGE.copy(), segmenter), FrameContext(IMAGE[:, ::-1].copy(), segmenter)
    for context in (left, right, left):
        assert context.masks is context.masks_as_recorded
    assert [image is each.bgr_as_recorded for image, each in zip(seen, (left, right), strict=True)] == [
        True
    ] * 2


def test_the_border_of_the_picture_is_black_in_every_channel(tmp_path: Path) -> None:
    image = np.full((48, 64, 3), (16, 24, 0), np.uint8)
    image[:, 32:, 1] = 25
    black = (
        OnnxSegmenter(rules(write_classifier(tmp_path / "n.onnx", WEIGHTS, BIAS, (64, 48))))
        .masks(image)
        .black
    )
    assert black is not None
    assert (black > 0).mean(0).tolist() == [1.0] * 32 + [0.0] * 32


def faulty(folder: Path, fault: str) -> OnnxSegmentation:
    """A profile's segmentation with one thing wrong."""
    path, size = folder / "net.onnx", (64, 48)
    image, x = value_info("image", [1, 3, 48, 64]), "image"
    good = rules(path)
    match fault:
        case "folder":
            path.mkdir()
        case "empty":
            path.touch()
        case "text":
            path.write_text("this is no network\n" * 9)
        case "truncated":
            whole = write_classifier(path, WEIGHTS, BIAS, size).read_bytes()
            path.write_bytes(whole[: len(whole) // 2])
        case "operator":
            write_model(path, [node("Frobnicate", [x], "y")], [], [image], [value_info("y", [1, 4, 48, 64])])
        case "vector":
            write_model(
                path,
                [node("GlobalAveragePool", [x], "p"), node("Flatten", ["p"], "y", axis=1)],
                [],
                [image],
                [value_info("y", [1, 3])],
            )
        case "fractions":
            write_classifier(path, WEIGHTS[:1], BIAS[:1], size)
        case "nan":
            write_classifier(path, WEIGHTS, np.array([0.0, 0.0, np.nan, 0.0]), size)
        case "two outputs" | "wrong output":
            tensors = [tensor(n, WEIGHTS[..., None, None]) for n in ("V", "W")]
            nodes = [node("Conv", [x, w], y, kernel_shape=[1, 1]) for w, y in (("V", "main"), ("W", "aux"))]
            write_model(
                path, nodes, tensors, [image], [value_info(y, [1, 4, 48, 64]) for y in ("main", "aux")]
            )
            return rules(path, output="mian") if fault == "wrong output" else good
        case "class":
            write_classifier(path, WEIGHTS, BIAS, size)
            return rules(path, shaft={"class_ids": [3, 7], "min_area_px": 1})
        case "size":
            product = node("MatMul", [x, "W"], "y")
            write_model(
                path, [product], [tensor("W", np.ones((5, 7)))], [image], [value_info("y", [1, 3, 48, 7])]
            )
        case "memory":
            # Padded to 2^25 px a side: 2^54 bytes and more, beyond any address space.
            write_classifier(path, WEIGHTS, BIAS, size, pad=1 << 24)
    return good


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("missing", "cannot read the network: No such file"),
        ("folder", "cannot read the network: Is a directory"),
        ("empty", "not an ONNX model"),
        ("text", "not an ONNX model"),
        ("truncated", "not an ONNX model"),
        ("operator", "cannot run this network: .*Frobnicate"),
        ("vector", r"output y has shape \(1, 3\); expected class scores \(1, C, h, w\), or labels"),
        ("fractions", "one channel, so that it should hold whole class numbers, and holds fractions"),
        ("nan", "output scores is not finite"),
        ("two outputs", "has 2 outputs; name one in segmentation.output: .*aux"),
        ("wrong output", "no output mian: did you mean main"),
        (
            "class",
            r"segmentation\.shaft\.class_ids asks for class 7, and the network tells 4 classes, 0 to 3",
        ),
        ("size", "does not run on one RGB image of 64x48"),
        ("memory", "not enough memory to run the network on 64x48"),
    ],
)
def test_a_fault_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], fault: str, message: str
) -> None:
    """Each fault shows when the segmenter is made, in one line with the file, and OpenCV adds nothing of its own."""
    with pytest.raises(ProfileError, match=message) as caught:
        OnnxSegmenter(faulty(tmp_path, fault))
    assert str(caught.value).startswith(f"{tmp_path / 'net.onnx'}: ")
    assert re.search(r"[\n\r]", str(caught.value)) is None
    assert capfd.readouterr().err == ""
