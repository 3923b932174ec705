"""Files to read: regular ones only, within their limit, and without waiting."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from svmdist.input_file import read_regular, why


def test_a_file_within_its_limit_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, 4)


@pytest.mark.parametrize("name", ["folder", "pipe", "missing", "nul\0"])
def test_anything_else_says_why_at_once(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError) as caught:  # noqa: PT011  (the reason is looked at below)
        read_regular(tmp_path / name, 10)
    expected = {
        "folder": "directory",
        "pipe": "no regular file",
        "missing": "No such file",
        "nul\0": "character",
    }
    assert expected[name] in why(caught.value)
