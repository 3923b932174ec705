"""Public images with masks of the instruments, each from a repository that was fetched to a folder beforehand.

No picture of them is in this repository. Where a set has no masks, `outlines.json` has outlines drawn by hand, in px of
the image, the first pixel's centre at (0, 0). Nothing of the network is trained on these sets or chosen by them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image

OUTLINES = Path(__file__).resolve().parent / "outlines.json"
PANEL_SIZE = (240, 427)
"""(h, w) of each of a panel's three pictures: the image, its classes, what some network made of it."""
GRASPER_BGR, HOOK_BGR = (233, 180, 86), (139, 139, 0)


@dataclass(frozen=True)
class MaskedImage:
    """An image in BGR, shape (h, w, 3), and where its instruments are, shape (h, w)."""

    name: str
    bgr: Image
    instruments: NDArray[np.bool_]


@dataclass(frozen=True)
class MaskedSet:
    """A set, its public repository, what it shows, and how its images are read from the folder of that repository."""

    name: str
    repository: str
    shows: str
    read: Callable[[Path], Iterator[MaskedImage]]

    def images(self, folder: Path) -> list[MaskedImage]:
        """All images with masks; none where the repository is not in `folder`."""
        root = folder / self.repository.split("/")[1]
        return list(self.read(root)) if root.is_dir() else []


def _outlined(key: str, where: str, width: int | None = None) -> Callable[[Path], Iterator[MaskedImage]]:
    """Images of a folder, given as a pattern, with our own outlines; `width` keeps the left part only."""

    def read(root: Path) -> Iterator[MaskedImage]:
        for name, outlines in json.loads(OUTLINES.read_text("utf-8"))[key].items():
            image = _read(next(root.glob(f"{where}/{name}")))[:, :width]
            yield MaskedImage(name, image, filled(outlines, (image.shape[0], image.shape[1])))

    return read


def filled(outlines: list[list[list[float]]], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Where the outlines, each of shape (n, 2) in px, are filled; shape `size` = (h, w)."""
    mask = np.zeros(size, np.uint8)
    for outline in outlines:
        points = np.rint(16 * np.array(outline)).astype(np.int32)
        cv2.fillPoly(mask, [points], 1, shift=4)
    return mask > 0


def _laparoscopy(root: Path) -> Iterator[MaskedImage]:
    folder = root / "Art-Net/AnnotationFullData/TestAnnotation"
    for path in sorted((folder / "PositiveImage").glob("*.png")):
        yield MaskedImage(path.name, _read(path), _read(folder / "toolmask" / path.name)[..., 0] > 127)


def _phantom(root: Path) -> Iterator[MaskedImage]:
    folder = root / "tests/Metrics/Data"
    for path in sorted((folder / "raw").glob("*.png")):
        label = _read(folder / "label" / path.name.replace("_img", "_label"))
        yield MaskedImage(path.name, _read(path), (label == (0, 255, 0)).all(-1))  # the needle is yellow


def _trainer(root: Path) -> Iterator[MaskedImage]:
    yield MaskedImage(
        "demo.jpg", _read(root / "data/demo.jpg"), _read(root / "data/demo_seg.png")[..., 0] > 127
    )


def _single(root: Path) -> Iterator[MaskedImage]:
    classes = _read(root / "images/img_40_class.png")
    yield MaskedImage("img_40_raw.png", _read(root / "images/img_40_raw.png"), classes[..., 0] > 0)


def _panels(root: Path) -> Iterator[MaskedImage]:
    height, width = PANEL_SIZE
    for path in sorted((root / "images").glob("*_panel.png")):
        panel = _read(path)
        image, classes = panel[:height, : width - 1], panel[:height, width : 2 * width - 1]
        mask = (classes == GRASPER_BGR).all(-1) | (classes == HOOK_BGR).all(-1)
        yield MaskedImage(path.name, np.ascontiguousarray(image), mask)


def _figure(root: Path) -> Iterator[MaskedImage]:
    figure = _read(root / "images/grid-1-41.png")
    image, mask = figure[2:184, 34:263], figure[195:377, 34:263]
    # The lines that part the instruments' pieces in the mask are black.
    whole = cv2.morphologyEx(
        (mask[..., 2] > 127).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    yield MaskedImage("grid-1-41.png", np.ascontiguousarray(image), whole > 0)


def _read(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{path}: expected an image")
    return np.asarray(image, np.uint8)


_SUPER_DEEP = "ForwardPassDeepLabCut/DaVinci-Ambar-2019-10-31/labeled-data/video_1"
SETS = (
    MaskedSet(
        "laparoscopy",
        "MahBadran93/Laparoscopic-Tools-Processing",
        "operation, 1920x1080, round border, green shaft",
        _laparoscopy,
    ),
    MaskedSet(
        "cholecystectomy",
        "Herbert-Research/surgical-instrument-segmentation",
        "operation, 640x360, round border",
        _outlined("cholecystectomy", "outputs/run_cholecseg_video01_test_*/frames"),
    ),
    MaskedSet("CholecSeg8k", "mhjd/cholecseg8k-deeplabv3", "operations, 426x240, round border", _panels),
    MaskedSet("EndoVis", "ternaus/robot-surgery-segmentation", "operation on a pig, 229x182", _figure),
    MaskedSet(
        "EndoMapper",
        "endomapperUZ/toolSegmentation",
        "operation, 640x480",
        _single,
    ),
    MaskedSet(
        "SuPer Deep",
        "ambareeshsrja16/Surgical_Tool_Tracking",
        "ex vivo tissue, 720x576",
        _outlined("super_deep", _SUPER_DEEP, 720),
    ),
    MaskedSet(
        "phantom", "surgical-robotics-ai/dVRK-segmentation-models", "silicone, bluish, 1280x1024", _phantom
    ),
    MaskedSet(
        "thrust", "fdheenmo/thrust", "paper, 640x480", _outlined("thrust", "50_images_15-Nov-17-59-04")
    ),
    MaskedSet("trainer", "luiscarlosgph/endotip", "box trainer, 980x988, round border", _trainer),
)
