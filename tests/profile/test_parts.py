"""The part of a profile about a network: its regions, and what cannot work."""

from typing import Any

import pytest
from pydantic import ValidationError

from svmdist.profile.segmentation import OnnxSegmentation

NETWORK: dict[str, Any] = {
    "method": "onnx",
    "model": "net.onnx",
    "width_px": 64,
    "height_px": 48,
    "tissue": {"class_ids": [1], "min_area_px": 5},
    "instrument": {"class_ids": [2, 3], "min_area_px": 5},
}


def test_a_network_s_parts_and_scale():
    """One number scales all channels; the parts are those that are given."""
    rules = OnnxSegmentation.model_validate({**NETWORK, "scale": 0.5})
    assert rules.scale == (0.5, 0.5, 0.5)
    assert set(rules.parts) == {"tissue", "instrument"}
    with_shaft = OnnxSegmentation.model_validate({**NETWORK, "shaft": {"class_ids": [4], "min_area_px": 5}})
    assert set(with_shaft.parts) == {"tissue", "instrument", "shaft"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scale": 0}, "see nothing"),
        ({"instrument": {"class_ids": [1, 2], "min_area_px": 5}}, "class 1 cannot be tissue and instrument"),
        ({"method": "svm"}, "Input should be 'hsv', 'onnx' or 'auto'"),
        ({"tissue": {"class_ids": [], "min_area_px": 5}}, "class_ids"),
    ],
)
def test_a_network_that_cannot_work_is_refused(change, words):
    with pytest.raises(ValidationError, match=words):
        OnnxSegmentation.model_validate({**NETWORK, **change})
