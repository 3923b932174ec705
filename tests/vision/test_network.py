"""Segmentation by a network: masks against an independent computation, faults of a profile, the network that ships."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.masks import instruments_of, iou
from svmdist.errors import ProfileError
from svmdist.profile import load_profile
from svmdist.profile.segmentation import ClassRegion, OnnxSegmentation
from svmdist.vision.network import OnnxSegmenter
from tests.onnx_file import node, tensor, value_info, write_classifier, write_model
from tests.pictures import surgery_image

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


@pytest.mark.parametrize("labels", ["", "keep", "drop"])
def test_masks_are_those_of_the_highest_score(tmp_path, labels):
    """Scores and both shapes of labels give, pixel for pixel, the class that NumPy finds."""
    model = write_classifier(tmp_path / "net.onnx", WEIGHTS, BIAS, (64, 48), labels=labels)
    masks = OnnxSegmenter(rules(model)).masks(IMAGE)
    best = (IMAGE[..., ::-1] / 255 @ WEIGHTS.T + BIAS).argmax(-1)
    for number, mask in enumerate((masks.tissue, masks.instrument, masks.shaft), 1):
        assert mask.dtype == np.uint8
        np.testing.assert_array_equal(mask, np.where(best == number, 255, 0))
        assert mask.any()


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
            nodes = [node("GlobalAveragePool", [x], "p"), node("Flatten", ["p"], "y", axis=1)]
            write_model(path, nodes, [], [image], [value_info("y", [1, 3])])
        case "fractions":
            write_classifier(path, WEIGHTS[:1], BIAS[:1], size)
        case "nan":
            write_classifier(path, WEIGHTS, np.array([0.0, 0.0, np.nan, 0.0]), size)
        case "two outputs" | "wrong output":
            tensors = [tensor(n, WEIGHTS[..., None, None]) for n in ("V", "W")]
            nodes = [node("Conv", [x, w], y, kernel_shape=[1, 1]) for w, y in (("V", "main"), ("W", "aux"))]
            outputs = [value_info(y, [1, 4, 48, 64]) for y in ("main", "aux")]
            write_model(path, nodes, tensors, [image], outputs)
            return rules(path, output="mian") if fault == "wrong output" else good
        case "class":
            write_classifier(path, WEIGHTS, BIAS, size)
            return rules(path, shaft={"class_ids": [3, 7], "min_area_px": 1})
        case "size":
            weights, output = tensor("W", np.ones((5, 7))), value_info("y", [1, 3, 48, 7])
            write_model(path, [node("MatMul", [x, "W"], "y")], [weights], [image], [output])
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
        ("class", r"shaft\.class_ids asks for class 7, and the network has 4 classes, 0 to 3"),
        ("size", "does not run on one RGB image of 64x48"),
        ("memory", "not enough memory to run the network on 64x48"),
    ],
)
def test_a_fault_is_one_line(tmp_path, capfd, fault, message):
    """Each fault shows when the segmenter is made, in one line with the file, and OpenCV adds nothing of its own."""
    with pytest.raises(ProfileError, match=message) as caught:
        OnnxSegmenter(faulty(tmp_path, fault))
    assert str(caught.value).startswith(f"{tmp_path / 'net.onnx'}: ")
    assert re.search(r"[\n\r]", str(caught.value)) is None
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scale": 0}, "see nothing"),
        ({"instrument": {"class_ids": [1, 2], "min_area_px": 5}}, "class 1 cannot be tissue and instrument"),
        ({"method": "svm"}, "Input should be 'hsv', 'onnx' or 'auto'"),
        ({"tissue": {"class_ids": [], "min_area_px": 5}}, "class_ids"),
    ],
)
def test_a_network_that_cannot_work_is_refused(tmp_path, change, words):
    """Where its rules are read; one number scales all channels, and a part may be missing."""
    few = rules(tmp_path, scale=0.5, shaft=None)
    assert (few.scale, set(few.parts)) == ((0.5, 0.5, 0.5), {"tissue", "instrument"})
    with pytest.raises(ValidationError, match=words):
        rules(tmp_path, **change)


def test_an_unknown_name_is_one_line_with_the_choices(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n[segmentation]\nmethod = "onnx"\nmodel = "svmdist:instrument"\n', "utf-8")
    with pytest.raises(ProfileError, match=r"no such network ships: .*svmdist:instruments") as caught:
        load_profile(path)
    assert "\n" not in str(caught.value)


def test_onnxruntime_and_opencv_say_the_same(monkeypatch):
    """To a thousandth; not to the last bit, which would be one of them twice."""
    shipped = OnnxSegmentation.model_validate({"method": "onnx", "model": "svmdist:instruments"})
    bgr, found = surgery_image(7000).bgr, [OnnxSegmenter(shipped)]
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    found.append(OnnxSegmenter(shipped))
    fast, slow = (one.outputs(bgr) for one in found)
    assert set(fast) == set(slow) == {"scores", "keypoints"}
    for name, values in fast.items():
        np.testing.assert_allclose(values, slow[name], atol=1e-3)
        assert (values != slow[name]).any()


def test_it_finds_instruments_in_pictures_of_another_renderer():
    """IoU of the union of instruments over tissue, mean of 12 pictures that the tests of `auto` are drawn with."""
    shipped = OnnxSegmentation.model_validate({"method": "onnx", "model": "svmdist:instruments"})
    segmenter = OnnxSegmenter(shipped)
    ious = []
    for seed in range(12):
        drawn = surgery_image(7000 + seed)
        ious.append(iou(instruments_of(segmenter.masks(drawn.bgr)), drawn.instruments > 0))
    assert np.mean(ious) >= 0.88
