"""The parts of a profile by themselves: topics and limits, other instruments, and rules of segmentation."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from svmdist.errors import ProfileError
from svmdist.profile.segmentation import OnnxSegmentation
from svmdist.profile.toml import Angle, NeighbourFile, Size, StrictModel, parse_toml

MIB = 1 << 20
NETWORK: dict[str, Any] = {
    "method": "onnx",
    "model": "net.onnx",
    "width_px": 64,
    "height_px": 48,
    "tissue": {"class_ids": [1], "min_area_px": 5},
    "instrument": {"class_ids": [2, 3], "min_area_px": 5},
}


class Inner(StrictModel):
    """A table."""

    width_px: int = 3


class Document(StrictModel):
    """A file with one of each kind of value."""

    size: Size = 4 * MIB
    angle: Angle = 0.0
    file: NeighbourFile | None = None
    inner: Inner = Inner()


def parsed(folder: Path, text: str) -> Document:
    path = folder / "document.toml"
    path.write_text(text, "utf-8")
    return parse_toml(path, Document, ProfileError)


def test_values_are_read_in_their_units(tmp_path):
    """Bytes with a unit, an angle as a multiple of pi, and a file beside the document, wherever that is."""
    found = parsed(tmp_path, 'size = "2 MiB"\nangle = "-pi/2"\nfile = "a/b.stl"\n[inner]\nwidth_px = 4\n')
    assert found.size == 2 * MIB
    assert found.angle == pytest.approx(-1.5707963267948966, abs=1e-15)
    assert found.file == tmp_path / "a" / "b.stl"
    assert found.inner.width_px == 4
    absolute = tmp_path.resolve() / "c.stl"
    assert parsed(tmp_path, f'file = "{absolute.as_posix()}"').file == absolute


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[inner]\nwidth = 4", ["unknown key inner.width", "width_px"]),
        ("[inner]\nwidth_px = 4.5", ["inner.width_px", "4.5"]),
        ('size = "2 MB"', ["size", "512 MiB"]),
        ("angle = nan", ["angle"]),
        ("angle = [", ["not a TOML file"]),
        # A calibration given as a profile is no list of unknown keys.
        (
            "schema = 1\nmethod = 2\nname = 3",
            ["not a document file: expected the keys", "found 'schema', 'method'"],
        ),
        ("".join(f"inner.k{number} = 1\n" for number in range(9)), ["and 4 more"]),
    ],
)
def test_a_mistake_names_file_and_key(tmp_path, text, words):
    with pytest.raises(ProfileError) as caught:
        parsed(tmp_path, text)
    for word in ["document.toml", *words]:
        assert word in str(caught.value)


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
