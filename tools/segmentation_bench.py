"""IoU of instruments on public images with masks: `auto` and a network side by side.

`uv run python -m tools.segmentation_bench FOLDER [--network FILE] [--out DIR]` runs on whatever of the sets is in
FOLDER (`git clone` of the repositories in `tools/segmentation_net/masked_sets.py`) and prints a table in Markdown. DIR
gets overlays: yellow what a method found, green the mask.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile import OnnxSegmentation
from svmdist.samples import Image
from svmdist.vision.segmentation.auto import AutoSegmenter
from svmdist.vision.segmentation.network import OnnxSegmenter
from svmdist.vision.segmentation.segmenter import Segmenter
from tools.segmentation_net.layout import network_rules
from tools.segmentation_net.masked_sets import SETS, MaskedImage
from tools.segmentation_net.overlap import iou

Mask = NDArray[np.bool_]
Method = Callable[[Sequence[Image]], Segmenter]
"""Makes what segments the images of one set, as it would those of one log."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the sets that are there and print their table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--network", type=Path, help="an ONNX file of tools.train_segmentation")
    parser.add_argument("--out", type=Path, help="folder for overlays")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    methods: dict[str, Method] = {"auto": _auto}
    if given.network is not None:
        rules: OnnxSegmentation = network_rules(given.network)
        network = OnnxSegmenter(rules)
        methods["network"] = lambda images: network  # noqa: ARG005
    print("| set | shows | images | " + " | ".join(f"`{name}`" for name in methods) + " |")
    print("|---|---|---|" + "---|" * len(methods))
    found_any = False
    spent: dict[str, list[float]] = {name: [] for name in methods}
    everything: dict[str, list[float]] = {name: [] for name in methods}
    for each in SETS:
        images = each.images(given.folder)
        if not images:
            print(f"{each.name}: not in {given.folder}; it is {each.repository}", file=sys.stderr)
            continue
        found_any = True
        cells = []
        for name, method in methods.items():
            segmenter = method([image.bgr for image in images])
            ious, false_parts = [], []
            for image in images:
                started = time.perf_counter()
                mask = instruments_of(segmenter, image.bgr)
                spent[name].append(time.perf_counter() - started)
                if image.instruments.any():
                    ious.append(iou(mask, image.instruments))
                else:
                    false_parts.append(float(mask.mean()))
                if given.out is not None:
                    _draw(given.out / name / f"{each.name} {Path(image.name).stem}.jpg", image, mask)
            everything[name] += ious
            cells.append(_cell(ious, false_parts))
        print(f"| {each.name} | {each.shows} | {len(images)} | " + " | ".join(cells) + " |")
    if not found_any:
        return 1
    print(
        f"| all | | {len(everything['auto'])} | "
        + " | ".join(f"{np.mean(v):.2f}" for v in everything.values())
        + " |"
    )
    for name, times in spent.items():
        print(f"{name}: {1e3 * float(np.median(times)):.0f} ms an image (median, one thread)")
    return 0


def instruments_of(segmenter: Segmenter, bgr: Image) -> Mask:
    """Shafts, wrists and jaws of all instruments, shape (h, w)."""
    masks = segmenter.masks(bgr, None)
    shaft = masks.shaft
    return (masks.instrument > 0) if shaft is None else ((masks.instrument | shaft) > 0)


def _auto(images: Sequence[Image]) -> Segmenter:
    """Learns from the set's images, as from those of a log; from a single image by itself."""
    return AutoSegmenter().adapted_to(images) if len(images) > 1 else AutoSegmenter()


def _cell(ious: list[float], false_parts: list[float]) -> str:
    text = f"{np.mean(ious):.2f}" + (f" ({min(ious):.2f} to {max(ious):.2f})" if len(ious) > 1 else "")
    if false_parts:
        text += f"; {100 * float(np.mean(false_parts)):.1f} % of images without instrument"
    return text


def _draw(path: Path, image: MaskedImage, mask: Mask) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = image.bgr.copy()
    for colour, which in (((0, 220, 0), image.instruments), ((0, 230, 255), mask)):
        outlines, _ = cv2.findContours(which.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, outlines, -1, colour, max(1, drawn.shape[1] // 500))
    cv2.imwrite(str(path), drawn)


if __name__ == "__main__":
    sys.exit(main())
