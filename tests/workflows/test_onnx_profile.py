"""A profile that segments by a network, from the command line to the distances."""

from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import DEFAULT_PROFILE, profile_path
from tests.onnx_file import write_classifier
from tests.shipped import write_profile

# Scores of background, tissue (red), instrument (cyan) and shaft (dark), linear in RGB from 0 to 1.
WEIGHTS = np.array([[0.0, 0.0, 0.0], [0.69, -0.5, -0.5], [-1.0, 0.36, 0.36], [-1.0, -1.0, -1.0]])
BIAS = np.array([0.0, 0.0, -0.02, 0.5])


@pytest.fixture(scope="module")
def onnx_profile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped profile with classes in place of colours, its model in a folder beside it."""
    folder = tmp_path_factory.mktemp("onnx")
    (folder / "models").mkdir()
    write_classifier(folder / "models" / "colours.onnx", WEIGHTS, BIAS, (640, 480))
    head = '[segmentation]\nmethod = "onnx"\nmodel = "models/colours.onnx"\nwidth_px = 640\nheight_px = 480\n\n'
    classes = [
        (
            rf"(?<=\[segmentation\.{part}\]\n)hue = .*\nsaturation = .*\nvalue = .*\n",
            f"class_ids = [{number}]\n",
        )
        for number, part in enumerate(("tissue", "instrument", "shaft"), 1)
    ]
    return write_profile(folder / "mine.toml", *classes, (r"(?=\[segmentation\.tissue\])", head))


def test_estimate_takes_the_profile(cli, golden, onnx_profile):
    """The model is found beside the profile, and measures the golden log as the colours do."""
    calibration = profile_path(DEFAULT_PROFILE).with_name("psm13.calibration.toml")
    few = ("--every", 4, "-f", "json")
    common = (golden / "contact.mcap", "--method", "centroid", "--calibration", calibration, *few)
    rows = [cli("estimate", *common, "--profile", name).json for name in (DEFAULT_PROFILE, onnx_profile)]
    assert [row["status"] for row in rows[0]] == [row["status"] for row in rows[1]]
    pairs = [(a["distance_m"], b["distance_m"]) for a, b in zip(*rows, strict=True) if a["status"] == "ok"]
    assert len(pairs) > 15
    np.testing.assert_allclose(*np.array(pairs).T, atol=3e-4)
