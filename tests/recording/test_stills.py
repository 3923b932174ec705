"""Image files: PNG and JPEG keep their bytes, other formats their pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import SourceError
from svmdist.profile import Limits
from svmdist.recording.images import decode_file, read_file

IMAGE = np.random.default_rng(4).integers(0, 255, (24, 32, 3), np.uint8)


def test_png_passes_through_and_bmp_is_decoded(tmp_path: Path) -> None:
    for name in ("a.png", "a.bmp"):
        cv2.imwrite(str(tmp_path / name), IMAGE)
    data = read_file(tmp_path / "a.png", Limits())
    assert data == (tmp_path / "a.png").read_bytes()
    assert isinstance(data, bytes)
    np.testing.assert_array_equal(decode_file(data, "a.png", Limits()), IMAGE)
    np.testing.assert_array_equal(read_file(tmp_path / "a.bmp", Limits()), IMAGE)


def test_sixteen_bits_and_no_image_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "deep.tiff"), IMAGE.astype(np.uint16))
    with pytest.raises(SourceError, match="16 bits; 8 are expected"):
        read_file(tmp_path / "deep.tiff", Limits())
    (tmp_path / "no.bmp").write_bytes(b"BMno")
    with pytest.raises(SourceError, match=r"no.bmp: not an image that can be decoded"):
        read_file(tmp_path / "no.bmp", Limits())
    with pytest.raises(SourceError, match="cannot read"):
        read_file(tmp_path, Limits())
