"""IoU of instruments on public images with masks: `auto` and a network side by side.

`uv run python -m benchmarks.masks FOLDER [--network FILE] [--renders N] [--out DIR]` runs on whatever of the
sets is in FOLDER (`git clone` of the repositories in `benchmarks/masked_sets.py`), and on N pictures that
are drawn as those of the training are, with other seeds. It prints a table in Markdown. DIR gets overlays: yellow what
a method found, green the mask.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.masked_sets import SETS, MaskedImage
from benchmarks.overlap import iou
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.network import OnnxSegmenter
from svmdist.vision.segmentation import AutoSegmenter, Segmenter
from training.dataset import VALIDATION_SEED
from training.instruments import DISTAL
from training.layout import network_rules
from training.scene import render

Mask = NDArray[np.bool_]
Method = Callable[[Sequence[Image]], Segmenter]
"""Makes what segments the images of one set, as it would those of one log."""
GOOD = 0.85
"""IoU that is asked for on images of operations."""


@dataclass
class Figures:
    """One method on one set: IoU of each image with instruments, and the part called one where there is none."""

    ious: list[float] = field(default_factory=list)
    false_parts: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, other: Figures) -> None:
        """Put another set's figures to these."""
        self.ious += other.ious
        self.false_parts += other.false_parts
        self.seconds += other.seconds

    def cell(self) -> str:
        """Mean and range, as the table shows them."""
        text = f"{np.mean(self.ious):.2f}"
        if len(self.ious) > 1:
            text += f" ({min(self.ious):.2f} to {max(self.ious):.2f})"
        if self.false_parts:
            text += f"; {100 * float(np.mean(self.false_parts)):.1f} % of {len(self.false_parts)} without any"
        return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the sets that are there and print their table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--network", type=Path, help="an ONNX file of training.train")
    parser.add_argument("--renders", type=int, default=0, help="how many drawn pictures to measure on")
    parser.add_argument("--out", type=Path, help="folder for overlays")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    methods: dict[str, Method] = {"auto": _auto(), "auto without the network": _auto(network_weight=0.0)}
    if given.network is not None:
        methods["network"] = _network(given.network, from_border=False)
        methods["network, from the border"] = _network(given.network, from_border=True)
    print("| set | shows | images | " + " | ".join(f"`{name}`" for name in methods) + " |")
    print("|---|---|---|" + "---|" * len(methods))
    real = {name: Figures() for name in methods}
    for each in SETS:
        images = each.images(given.folder)
        if not images:
            print(f"{each.name}: not in {given.folder}; it is {each.repository}", file=sys.stderr)
            continue
        row = {name: _measured(method, images) for name, method in methods.items()}
        for name, figures in row.items():
            real[name].add(figures)
        print(_row(each.name, each.shows, len(images), row), flush=True)
        if given.out is not None:
            for name, method in methods.items():
                _draw_all(given.out / name, each.name, images, method)
    if given.renders:
        drawn = {name: Figures() for name in methods}
        for seed in range(VALIDATION_SEED, VALIDATION_SEED + given.renders):
            image, labels = render(seed)
            for name, method in methods.items():
                drawn[name].add(_measured(method, [MaskedImage(str(seed), image, labels >= DISTAL)]))
        print(_row("drawn", "as those trained on, other seeds, 256x192", given.renders, drawn))
    if not real["auto"].ious:
        return 0 if given.renders else 1
    print()
    for name, figures in real.items():
        good = np.mean(np.array(figures.ious) >= GOOD)
        print(
            f"{name}: IoU on all {len(figures.ious)} images with instruments {np.mean(figures.ious):.3f}, median"
            f" {np.median(figures.ious):.3f}, at least {GOOD} on {100 * good:.0f} %;"
            f" {1e3 * float(np.median(figures.seconds)):.0f} ms an image on one thread"
        )
    return 0


def instruments_of(segmenter: Segmenter, bgr: Image) -> Mask:
    """Shafts, wrists and jaws of all instruments, shape (h, w)."""
    masks = segmenter.masks(bgr, None)
    shaft = masks.shaft
    return (masks.instrument > 0) if shaft is None else ((masks.instrument | shaft) > 0)


def _auto(**settings: float) -> Method:
    """Learns from the set's images, as from those of a log; from a single image by itself."""
    segmenter = AutoSegmenter(AutoSettings.model_validate(settings))
    return lambda images: segmenter.adapted_to(images) if len(images) > 1 else segmenter


def _network(model: Path, *, from_border: bool) -> Method:
    network = OnnxSegmenter(network_rules(model, from_border=from_border))
    return lambda images: network  # noqa: ARG005


def _measured(method: Method, images: Sequence[MaskedImage]) -> Figures:
    segmenter = method([image.bgr for image in images])
    figures = Figures()
    for image in images:
        started = time.perf_counter()
        mask = instruments_of(segmenter, image.bgr)
        figures.seconds.append(time.perf_counter() - started)
        if image.instruments.any():
            figures.ious.append(iou(mask, image.instruments))
        else:
            figures.false_parts.append(float(mask.mean()))
    return figures


def _row(name: str, shows: str, count: int, row: dict[str, Figures]) -> str:
    return f"| {name} | {shows} | {count} | " + " | ".join(figures.cell() for figures in row.values()) + " |"


def _draw_all(folder: Path, set_name: str, images: Sequence[MaskedImage], method: Method) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    segmenter = method([image.bgr for image in images])
    for image in images:
        drawn = image.bgr.copy()
        found = instruments_of(segmenter, image.bgr)
        for colour, which in (((0, 220, 0), image.instruments), ((0, 230, 255), found)):
            outlines, _ = cv2.findContours(which.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(drawn, outlines, -1, colour, max(1, drawn.shape[1] // 500))
        name = f"{set_name}-{Path(image.name).stem}".replace(" ", "-").lower()
        cv2.imwrite(str(folder / f"{name}.jpg"), drawn)


if __name__ == "__main__":
    sys.exit(main())
