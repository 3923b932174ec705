"""Train the small segmentation network on pictures that are drawn here, and write it as ONNX.

`uv run --with torch==2.13.0 --with onnx python -m training.train net.onnx` takes about an hour on two cores
and needs no picture from elsewhere: `training` draws them. PyTorch is no dependency of svmdist; any
environment with torch, onnx and svmdist serves. The same seed and versions give the same network on the same machine.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import gettempdir

import cv2
import numpy as np

from svmdist.profile.segmentation import INSTRUMENTS, OnnxSegmentation
from svmdist.vision.network import network_input
from training.instruments import DISTAL
from training.scene import VALIDATION_SEED, iou, rendered

MOST_BYTES = 4 << 20
MOST_DIFFERENCE = 1e-3  # of scores, which are of the order of 10, between PyTorch and OpenCV


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, train, write the file, and compare it as OpenCV runs it with PyTorch's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path, help="the ONNX file to write")
    parser.add_argument("--pictures", type=int, default=24000, help="how many are drawn to train on")
    parser.add_argument("--validation", type=int, default=400, help="how many others are drawn to measure on")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1, help="for drawing; training takes one thread")
    parser.add_argument("--cache", type=Path, default=Path(gettempdir(), "svmdist-segmentation-pictures"))
    given = parser.parse_args(arguments)
    try:
        from training.network import export, predicted, scores_of, train
    except ModuleNotFoundError as missing:
        print(
            f"{missing.name} is not installed: pip install torch==2.13.0 onnx, beside svmdist",
            file=sys.stderr,
        )
        return 1
    images, labels = rendered(VALIDATION_SEED, given.validation, given.cache, given.processes)
    pictures = rendered(given.seed * given.pictures, given.pictures, given.cache, given.processes)
    net = train(*pictures, given.seed)
    pairs = zip(predicted(net, images) >= DISTAL, labels >= DISTAL, strict=True)
    ious = np.array([iou(found, truth) for found, truth in pairs if truth.any()])
    print(f"IoU of instruments on {len(ious)} pictures: mean {ious.mean():.3f}, median {np.median(ious):.3f}")
    given.model.parent.mkdir(parents=True, exist_ok=True)
    export(net, given.model)
    difference = 0.0
    rules = OnnxSegmentation.model_validate({**INSTRUMENTS, "method": "onnx", "model": given.model})
    opencv = cv2.dnn.readNetFromONNX(str(given.model))
    for image in images[:20]:
        opencv.setInput(network_input(np.array(image), rules))
        difference = max(difference, float(np.abs(opencv.forward() - scores_of(net, image[None])).max()))
    size = given.model.stat().st_size
    print(f"{given.model}: {size / 2**20:.2f} MiB; scores by OpenCV differ by at most {difference:.1e}")
    return 0 if size <= MOST_BYTES and difference <= MOST_DIFFERENCE else 1


if __name__ == "__main__":
    sys.exit(main())
