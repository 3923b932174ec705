"""Image files: natural order, patterns, and which of two views belong together."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.errors import SourceError
from svmdist.importing.images import list_images, matching, numbers_of


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).touch()
    return folder


def test_order_is_that_of_numbers_and_patterns_choose(tmp_path):
    touched(tmp_path, "f10_L.png", "f2_L.png", "f2_R.png", "notes.txt")
    assert [path.name for path in list_images(tmp_path, "*_L.png")] == ["f2_L.png", "f10_L.png"]
    with pytest.raises(SourceError, match=r"none of 3 images is a \*.bmp; the first is f2_L.png"):
        list_images(tmp_path, "*.bmp")


def test_a_folder_without_images_says_what_it_has(tmp_path):
    with pytest.raises(SourceError, match="found 1 other files"):
        list_images(touched(tmp_path, "notes.txt"))


def test_views_are_paired_by_their_last_number():
    left, right = [Path("a1.png"), Path("a2.png")], [Path("b2.png"), Path("b1.png")]
    assert matching(left, right) == [Path("b1.png"), Path("b2.png")]
    with pytest.raises(SourceError, match=r"a2.png: there is no right image of that number"):
        matching(left, right[1:])
    with pytest.raises(SourceError, match=r"b2.png: there is no left image of that number"):
        matching(left[:1], right)


def test_numbers_that_stand_twice_tell_no_place():
    assert numbers_of(["a7.png", "a9.png"]) == {7: 0, 9: 1}
    assert numbers_of(["a7.png", "b7.png"]) == {}
