"""A calibration's YAML: OpenCV's dialect, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.errors import SourceError
from svmdist.importing.calibration import MAX_BYTES, read_yaml

OPENCV = "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1., 2. ]\n"


def test_opencvs_dialect_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(OPENCV)
    assert read_yaml(path) == {"K": {"rows": 1, "cols": 2, "dt": "d", "data": [1.0, 2.0]}}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- 1\n", "found list"),
        ("a: &x 1\nb: *x\n", "an alias"),
        ("a: [", "not a YAML file"),
        ("#" * (MAX_BYTES + 1), "the limit"),
    ],
)
def test_anything_else_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(SourceError, match=said) as caught:
        read_yaml(path)
    assert "\n" not in str(caught.value)
