"""Train the small segmentation network on pictures that are drawn here and on real ones, and write it as ONNX.

`uv run --with torch==2.13.0 --with onnx python -m training.train net.onnx [--pictures FOLDER...]`: one core, two hours.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2

from training.scene import VALIDATION_SEED, rendered


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw, train, calibrate, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("model", type=Path, help="the ONNX file to write")
    add("--pictures", type=Path, nargs="*", default=[], help="repositories that are checked out")
    add("--minutes", type=float, default=100.0)
    add("--drawn", type=int, default=6000, help="how many pictures are drawn to train on")
    add("--seed", type=int, default=0, help="of weights, and, times a million, of the pictures")
    add("--processes", type=int, default=1, help="for drawing; training takes one thread")
    given = parser.parse_args(arguments)
    try:
        from training.network import calibrate, export, train
        from training.pictures import outlined
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed: pip install torch==2.13.0 onnx", file=sys.stderr)
        return 1
    cv2.setNumThreads(1)
    drawn = rendered(1_000_000 * given.seed, given.drawn, given.processes)
    net = train(drawn, outlined(given.pictures), given.minutes, given.seed)
    calibrate(net, rendered(VALIDATION_SEED, 400, given.processes), outlined(given.pictures, held_out=True))
    export(net, given.model)
    print(f"{given.model}: {given.model.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
