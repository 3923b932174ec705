"""`svmdist show --masks`: pictures that are there, of the images that were asked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.cli.show import DEFAULT_COUNT
from tests.cli.conftest import Cli
from tests.synthetic import write_log


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic log of nine frames."""
    return write_log(tmp_path_factory.mktemp("showing") / "a.mcap", frame_count=9)


def test_one_image_by_number_or_time(cli: Cli, log: Path, tmp_path: Path) -> None:
    """The file's name has the image's number; the picture holds the image and a caption."""
    outcome = cli("show", log, "--masks", "--frame", "3", "-o", tmp_path / "new")
    assert outcome.code == 0
    path = tmp_path / "new" / "a-00003.png"
    assert outcome.out.strip() == str(path)
    picture = cv2.imread(str(path))
    assert picture is not None
    assert picture.shape[1] >= 900
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10
    again = cli("show", log, "--masks", "--at", "0", "-o", tmp_path / "new")
    assert again.out.strip().endswith("a-00000.png")


def test_images_from_the_first_to_the_last(cli: Cli, log: Path, tmp_path: Path) -> None:
    """Six of nine, both ends among them."""
    names = [Path(line).name for line in cli("show", log, "--masks", "-o", tmp_path).out.split()]
    assert len(names) == DEFAULT_COUNT == 6
    assert names[0] == "a-00000.png"
    assert names[-1] == "a-00008.png"


def test_with_segmentation_that_learns(cli: Cli, log: Path, tmp_path: Path) -> None:
    """`auto` needs no colour in the profile."""
    profile = tmp_path / "auto.toml"
    profile.write_text(
        'name = "auto"\n[topics]\nimage = "/ECM/left/image"\ncamera_info = "/ECM/left/camera_info"\n'
        '[segmentation]\nmethod = "auto"\n'
    )
    assert cli("show", log, "--masks", "--frame", "0", "--profile", profile, "-o", tmp_path).code == 0
    assert (tmp_path / "a-00000.png").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--masks", "--frame", "9"), "has 9 images, 0 to 8"),
        (("--masks", "--frame", "1", "--at", "2"), "give one of them"),
    ],
)
def test_what_cannot_be_shown(
    cli: Cli, log: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    """One line, exit code 2, no file."""
    outcome = cli("show", log, *arguments, "-o", tmp_path)
    assert outcome.code == 2
    assert said in outcome.err
    assert not list(tmp_path.glob("*.png"))


def test_a_folder_that_cannot_be_made(cli: Cli, log: Path, tmp_path: Path) -> None:
    """Told before the work."""
    (tmp_path / "file").write_text("x")
    outcome = cli("show", log, "--masks", "-o", tmp_path / "file" / "in")
    assert outcome.code == 1
    assert "cannot make the folder" in outcome.err
