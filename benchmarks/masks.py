"""IoU of instruments on public images with masks: `auto` and the network that ships, side by side.

`uv run python -m benchmarks.masks FOLDER [--renders N]` runs on whatever of the sets is in FOLDER (`git clone` of the
repositories in SETS), and on N pictures that are drawn as those of the training are, with other seeds. It prints
a table. Where a set has no masks, `outlines.json` has outlines drawn by hand, in px of the image. Nothing of the
network is trained on these sets or chosen by them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.generated_pages import table_row
from svmdist.profile.segmentation import INSTRUMENTS, OnnxSegmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.find_instruments import AutoSegmenter
from svmdist.vision.network import OnnxSegmenter
from svmdist.vision.segmentation import Segmenter
from training.instruments import DISTAL
from training.scene import VALIDATION_SEED, iou, render

Mask = NDArray[np.bool_]
Masked = Iterator[tuple[Image, Mask]]
"""Images in BGR, shape (h, w, 3), and where their instruments are, shape (h, w)."""
OUTLINES = Path(__file__).with_name("outlines.json")
PANEL_SIZE = (240, 427)
"""(h, w) of each of a panel's three pictures: the image, its classes, what some network made of it."""
GRASPER_BGR, HOOK_BGR = (233, 180, 86), (139, 139, 0)
SUPER_DEEP = "ForwardPassDeepLabCut/DaVinci-Ambar-2019-10-31/labeled-data/video_1"


def _read(path: Path) -> Image:
    if (image := cv2.imread(str(path), cv2.IMREAD_COLOR)) is None:
        raise SystemExit(f"{path}: expected an image")
    return np.asarray(image, np.uint8)


def filled(outlines: list[list[list[float]]], size: tuple[int, int]) -> Mask:
    """Where the outlines, each of shape (n, 2) in px, are filled; shape `size` = (h, w)."""
    mask = np.zeros(size, np.uint8)
    for outline in outlines:
        cv2.fillPoly(mask, [np.rint(16 * np.array(outline)).astype(np.int32)], 1, shift=4)
    return mask > 0


def _outlined(key: str, where: str, width: int | None = None) -> Callable[[Path], Masked]:
    """Images of a folder, given as a pattern, with our own outlines; `width` keeps the left part only."""

    def read(root: Path) -> Masked:
        for name, outlines in json.loads(OUTLINES.read_text("utf-8"))[key].items():
            image = _read(next(root.glob(f"{where}/{name}")))[:, :width]
            yield image, filled(outlines, (image.shape[0], image.shape[1]))

    return read


def _laparoscopy(root: Path) -> Masked:
    folder = root / "Art-Net/AnnotationFullData/TestAnnotation"
    for path in sorted((folder / "PositiveImage").glob("*.png")):
        yield _read(path), _read(folder / "toolmask" / path.name)[..., 0] > 127


def _phantom(root: Path) -> Masked:
    folder = root / "tests/Metrics/Data"
    for path in sorted((folder / "raw").glob("*.png")):
        label = _read(folder / "label" / path.name.replace("_img", "_label"))
        yield _read(path), (label == (0, 255, 0)).all(-1)  # the needle is yellow


def _single(image: str, mask: str, above: int) -> Callable[[Path], Masked]:
    """One image, and the mask whose levels are above one."""
    return lambda root: iter([(_read(root / image), _read(root / mask)[..., 0] > above)])


def panels(root: Path) -> Masked:
    """Panels of three pictures: the image, its classes, and one that is not used."""
    height, width = PANEL_SIZE
    for path in sorted((root / "images").glob("*_panel.png")):
        panel = _read(path)
        image, classes = panel[:height, : width - 1], panel[:height, width : 2 * width - 1]
        yield np.ascontiguousarray(image), (classes == GRASPER_BGR).all(-1) | (classes == HOOK_BGR).all(-1)


def _figure(root: Path) -> Masked:
    figure = _read(root / "images/grid-1-41.png")
    parts = (figure[195:377, 34:263, 2] > 127).astype(np.uint8)  # by black lines, which are closed here
    whole = cv2.morphologyEx(parts, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    yield np.ascontiguousarray(figure[2:184, 34:263]), whole > 0


SETS: dict[str, tuple[str, str, Callable[[Path], Masked]]] = {
    "laparoscopy": ("MahBadran93/Laparoscopic-Tools-Processing", "operation, 1920x1080", _laparoscopy),
    "cholecystectomy": (
        "Herbert-Research/surgical-instrument-segmentation",
        "operation, 640x360",
        _outlined("cholecystectomy", "outputs/run_cholecseg_video01_test_*/frames"),
    ),
    "CholecSeg8k": ("mhjd/cholecseg8k-deeplabv3", "operations, 426x240", panels),
    "EndoVis": ("ternaus/robot-surgery-segmentation", "operation on a pig, 229x182", _figure),
    "EndoMapper": (
        "endomapperUZ/toolSegmentation",
        "operation, 640x480",
        _single("images/img_40_raw.png", "images/img_40_class.png", 0),
    ),
    "SuPer Deep": (
        "ambareeshsrja16/Surgical_Tool_Tracking",
        "ex vivo tissue, 720x576",
        _outlined("super_deep", SUPER_DEEP, 720),
    ),
    "phantom": ("surgical-robotics-ai/dVRK-segmentation-models", "silicone, 1280x1024", _phantom),
    "thrust": ("fdheenmo/thrust", "paper, 640x480", _outlined("thrust", "50_images_15-Nov-17-59-04")),
    "trainer": (
        "luiscarlosgph/endotip",
        "box trainer, 980x988",
        _single("data/demo.jpg", "data/demo_seg.png", 127),
    ),
}
"""Each set's public repository, what it shows, and how its images are read from the folder of that repository."""


def instruments_of(segmenter: Segmenter, bgr: Image) -> Mask:
    """Shafts, wrists and jaws of all instruments, shape (h, w)."""
    masks = segmenter.masks(bgr)
    return (masks.instrument > 0) if masks.shaft is None else ((masks.instrument | masks.shaft) > 0)


def _segmenters(images: Sequence[Image]) -> dict[str, Segmenter]:
    """What segments the images of one set, as it would those of one log."""
    found: dict[str, Segmenter] = {}
    for name, settings in (("`auto`", {}), ("`auto` without the network", {"network_weight": 0.0})):
        auto = AutoSegmenter(AutoSettings.model_validate(settings))
        found[name] = auto.adapted_to(images) if len(images) > 1 else auto
    for name, from_border in (("network", False), ("network, from the border", True)):
        rules = {**INSTRUMENTS, "method": "onnx", "model": "svmdist:instruments", "from_border": from_border}
        found[name] = OnnxSegmenter(OnnxSegmentation.model_validate(rules))
    return found


def print_row(name: str, shows: str, sets: Sequence[Sequence[tuple[Image, Mask]]]) -> None:
    """Mean and range of the IoU, and what is called an instrument where there is none, by method."""
    ious, wrong = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for images in sets:
        for method, segmenter in _segmenters([bgr for bgr, _ in images]).items():
            for bgr, truth in images:
                found = instruments_of(segmenter, bgr)
                into, value = (ious, iou(found, truth)) if truth.any() else (wrong, float(found.mean()))
                into[method].append(value)
    cells = (
        f"{method}: {np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"
        + (f"; {100 * float(np.mean(wrong[method])):.1f}%" if method in wrong else "")
        for method, values in ious.items()
    )
    print(table_row((name, shows, str(sum(map(len, sets))), *cells)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--renders", type=int, default=0, help="how many drawn pictures to measure on")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    for name, (repository, shows, read) in SETS.items():
        root = given.folder / repository.split("/")[1]
        if root.is_dir():
            print_row(name, shows, [list(read(root))])
        else:
            print(f"{name}: not in {given.folder}; it is {repository}", file=sys.stderr)
    if given.renders:
        pictures = map(render, range(VALIDATION_SEED, VALIDATION_SEED + given.renders))
        print_row("drawn", "", [[(bgr, labels >= DISTAL)] for bgr, labels in pictures])
