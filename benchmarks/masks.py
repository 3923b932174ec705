"""IoU of instruments on public images with masks: `auto`, and the network that ships.

`uv run python -m benchmarks.masks FOLDER [--renders N]` runs on whatever of the sets is in FOLDER (`git clone` of the
repositories in SETS), and on N pictures that are rendered as those of the training are, with other seeds. It prints
a table, with means and the worst set, and of the pixels to which the network gives a probability from 0.85 to 0.95
the share that is instrument. Where a set has no masks, `outlines.json` has outlines drawn by hand, in px of the image.
Nothing of the network is trained on these sets or chosen by them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.generated_pages import table_row
from svmdist.profile.segmentation import INSTRUMENTS, OnnxSegmentation
from svmdist.samples import Image
from svmdist.vision.colour import Masks
from svmdist.vision.instruments.find_instruments import auto_masks
from svmdist.vision.network import OnnxSegmenter
from training.instruments import DISTAL
from training.scene import VALIDATION_SEED, render

Mask = NDArray[np.bool_]
Masked = Iterator[tuple[Image, Mask]]
"""Images in BGR, shape (h, w, 3), and where their instruments are, shape (h, w)."""
OUTLINES = Path(__file__).with_name("outlines.json")
CALIBRATED = (0.85, 0.95)  # which probabilities are called 0.9
PANEL_SIZE = (240, 427)
"""(h, w) of each of a panel's three pictures: the image, its classes, what some network made of it."""
GRASPER_BGR, HOOK_BGR = (233, 180, 86), (139, 139, 0)
ENDOVIS_2015 = "t*/img_*_raw.png"
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


def _polygons(images: str, labels: str) -> Callable[[Path], Masked]:
    """Images, given as a pattern, with outlines by labelme in a file of the same name, in a folder beside theirs."""

    def read(root: Path) -> Masked:
        for path in sorted(root.glob(images)):
            outlines = json.loads((path.parent / labels / f"{path.stem}.json").read_text("utf-8"))["shapes"]
            image = _read(path)
            points = [one["points"] for one in outlines if len(one["points"]) > 2]
            yield image, filled(points, (image.shape[0], image.shape[1]))

    return read


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
    "EndoVis 2015": (
        "Warlord437/Surgical-Image-Segmentation",
        "operations, 640x480",
        _polygons(ENDOVIS_2015, "."),
    ),
    "Cholec80": (
        "labdeeman7/cholec_instance_seg",
        "operation, 854x480",
        _polygons("utilities/_sample_files/*/img_dir/*.png", "../ann_dir"),
    ),
}
"""Each set's public repository, what it shows, and how its images are read from the folder of that repository."""


def instruments_of(masks: Masks) -> Mask:
    """Shafts, wrists and jaws of all instruments, shape (h, w)."""
    return (masks.instrument > 0) if masks.shaft is None else ((masks.instrument | masks.shaft) > 0)


@cache
def shipped_network(*, from_border: bool) -> OnnxSegmenter:
    """The network that ships, with all that it takes for an instrument, or with what comes in from the border alone."""
    rules = {**INSTRUMENTS, "method": "onnx", "model": "svmdist:instruments", "from_border": from_border}
    return OnnxSegmenter(OnnxSegmentation.model_validate(rules))


def iou(found: Mask, truth: Mask) -> float:
    """Intersection over union of two masks of one shape; 1 of two that are empty."""
    either = int((found | truth).sum())
    return float((found & truth).sum()) / either if either else 1.0


def nine_of_ten(network: OnnxSegmenter, bgr: Image, truth: Mask) -> Mask:
    """Whether it is instrument, of each pixel to which the network gives a probability of about 0.9, shape (n,)."""
    left, top, width, height = network.view(bgr)
    scores = network.scores(np.ascontiguousarray(bgr[top : top + height, left : left + width]))
    likely = np.exp(scores - scores.max(0))
    share = likely[DISTAL:].sum(0) / likely.sum(0)
    likely = cv2.resize(share, (width, height))
    inside = truth[top : top + height, left : left + width]
    return np.asarray(inside[(likely >= CALIBRATED[0]) & (likely <= CALIBRATED[1])])


Scores = dict[str, list[float]]


def print_row(name: str, shows: str, images: Sequence[tuple[Image, Mask]]) -> tuple[Scores, float]:
    """Mean and range of the IoU by method, and what is called an instrument where there is none; gives the IoUs.

    And of the network: which share of the pixels at 0.9 is instrument.
    """
    ious, wrong, likely = (
        defaultdict[str, list[float]](list),
        defaultdict[str, list[float]](list),
        list[Mask](),
    )
    network = shipped_network(from_border=False)
    segmenters: dict[str, Callable[[Image], Masks]] = {
        "`auto`": auto_masks,
        "network": network.masks,
        "network, from the border": shipped_network(from_border=True).masks,
    }
    for method, masks_of in segmenters.items():
        for bgr, truth in images:
            found = instruments_of(masks_of(bgr))
            into, value = (ious, iou(found, truth)) if truth.any() else (wrong, float(found.mean()))
            into[method].append(value)
            if method == "network":
                likely.append(nine_of_ten(network, bgr, truth))
    cells = (
        f"{method}: {np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"
        + (f"; {100 * float(np.mean(wrong[method])):.1f}%" if method in wrong else "")
        for method, values in ious.items()
    )
    share = float(np.mean(np.concatenate(likely)))
    print(table_row((name, shows, str(len(images)), *cells, f"at 0.9: {share:.2f}")))
    return ious, share


def print_means(rows: Sequence[tuple[Scores, float]]) -> None:
    """Means over sets, over images, and the worst set, by method."""
    sets = {method: [ious[method] for ious, _ in rows] for method in rows[0][0]}
    means = {method: [float(np.mean(one)) for one in all_of] for method, all_of in sets.items()}
    images = {method: float(np.mean(np.concatenate(all_of))) for method, all_of in sets.items()}
    share = f"at 0.9: {np.mean([share for _, share in rows]):.2f}"
    print(table_row(("mean of sets", "", "", *(f"{m}: {np.mean(v):.3f}" for m, v in means.items()), share)))
    print(table_row(("mean of images", "", "", *(f"{m}: {v:.3f}" for m, v in images.items()), "")))
    print(table_row(("worst set", "", "", *(f"{m}: {min(v):.2f}" for m, v in means.items()), "")))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--renders", type=int, default=0, help="how many rendered pictures to measure on")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = []
    for name, (repository, shows, read) in SETS.items():
        root = given.folder / repository.split("/")[1]
        if root.is_dir():
            rows.append(print_row(name, shows, list(read(root))))
        else:
            print(f"{name}: not in {given.folder}; it is {repository}", file=sys.stderr)
    if rows:
        print_means(rows)
    if given.renders:
        pictures = map(render, range(VALIDATION_SEED, VALIDATION_SEED + given.renders))
        print_row("drawn", "", [(bgr, labels >= DISTAL) for bgr, labels, _ in pictures])
