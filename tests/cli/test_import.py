"""`svmdist import`: files become a log that the other commands read; wrong options are one line."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import Cli


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two images of a view, as an endoscope's recorder leaves them."""
    images = tmp_path / "endoscope"
    images.mkdir()
    for number in range(2):
        cv2.imwrite(str(images / f"img{number}.png"), np.full((48, 64, 3), 90, np.uint8))
    return images


def test_import_then_info(cli: Cli, folder: Path, tmp_path: Path) -> None:
    """The imported log has images and a camera, and says where it is from."""
    log = tmp_path / "out.mcap"
    outcome = cli("import", folder, "--camera", "60,61,31,23", "--rate", "25", "-o", log)
    assert (outcome.code, outcome.out) == (0, "")
    assert "2 /ECM/left/image" in outcome.err
    told = cli("info", log)
    assert told.code == 0
    assert "64x48, fx 60.00, fy 61.00" in told.out
    assert "imported_from endoscope" in told.out
    assert "health      clean" in told.out


def test_pair_without_baseline_is_told(cli: Cli, folder: Path, tmp_path: Path) -> None:
    """Two views without a baseline are imported, and it is said what that costs."""
    log = tmp_path / "out.mcap"
    outcome = cli("import", folder, "--side-by-side", "--camera", "60,60,15,23", "--rate", "1", "-o", log)
    assert outcome.code == 0
    assert "no baseline is known" in outcome.err


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        ((), 2, "a camera needs a calibration: --calibration FILE, or --camera"),
        (("--camera", "60,60"), 2, "--camera 60,60: expected FX,FY,CX,CY"),
        (("--camera", "60,60,1,x"), 2, "expected numbers between commas"),
        (("--camera", "60,61,31,23"), 2, "img0.png tells no time"),
        (("--camera", "60,61,310,23", "--rate", "1"), 1, "the principal point (310, 23) is outside"),
        (
            ("--camera", "60,61,31,23", "--rate", "0"),
            2,
            "'--rate': Input should be greater than or equal to 0.001",
        ),
        (("--camera", "60,61,31,23", "--unit", "inch"), 2, "'--unit': inch: the choices are: cm, m, mm"),
        (("--camera", "60,61,31,23", "--baseline", "5mm"), 2, "--baseline is of two views"),
        (
            ("--camera", "60,61,31,23", "--distortion", "0.1,0.2", "--rate", "1"),
            2,
            "--distortion: expected 4, 5",
        ),
        (("--calibration", "no.yaml", "--rate", "1"), 1, "no.yaml: cannot read: No such file"),
        (("--camera", "60,61,31,23", "--times", "no.csv"), 1, "no.csv: cannot read"),
        (("--camera", "60,61,31,23", "--rate", "1", "--times", "no.csv"), 2, "cannot be combined"),
        (("--camera", "60,61,31,23", "--rate", "1", "--poses", "no.csv"), 1, "no.csv: cannot read"),
        (("--camera", "60,61,31,23", "--rate", "1", "--start", "soon"), 2, "--start soon: expected a time"),
        (
            ("--camera", "60,61,31,23", "--rate", "1", "--poses", "a.csv", "--poses", "b.csv"),
            2,
            "two files for the",
        ),
        (("--right-camera", "60,61,31,23"), 2, "--right-camera goes with --camera"),
    ],
)
def test_wrong_options(
    cli: Cli, folder: Path, tmp_path: Path, options: tuple[str, ...], code: int, said: str
) -> None:
    """Each is one line with the right exit code, and no log is left."""
    log = tmp_path / "out.mcap"
    outcome = cli("import", folder, "-o", log, *options)
    assert outcome.code == code, outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err
    assert said in outcome.err
    assert not log.exists()
