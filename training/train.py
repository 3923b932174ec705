"""Go on training the segmentation network on pictures that are drawn here and on real ones.

`uv run --with torch==2.13.0 --with onnx python -m training.train net.onnx [--pictures FOLDER...]`: one core, an hour.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2

from training.scene import rendered

EARLIER = "commit 9154100"  # its drawings taught the old net, which knows silicone and rooms best
SHIPPED = Path(__file__).parents[1] / "svmdist" / "models" / "instruments.onnx"


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw, train, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("model", type=Path, help="the ONNX file to write")
    add("--pictures", type=Path, nargs="*", default=[], help="repositories that are checked out")
    add("--earlier", type=Path, help=f"a checkout of {EARLIER}, whose drawings are rehearsed")
    add("--start", type=Path, default=SHIPPED, help="the ONNX file to go on from")
    add("--minutes", type=float, default=50.0)
    add("--drawn", type=int, default=5000, help="how many pictures are drawn to train on")
    add("--seed", type=int, default=0, help="of the order, and, times a million, of the pictures")
    add("--processes", type=int, default=1, help="for drawing; training takes one thread")
    given = parser.parse_args(arguments)
    try:
        from training.network import Network, train
        from training.pictures import Shown, drawn_earlier, masked, outlined
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed: pip install torch==2.13.0 onnx", file=sys.stderr)
        return 1
    cv2.setNumThreads(1)
    drawn = rendered(1_000_000 * given.seed, given.drawn, given.processes)
    count = 2 * given.drawn
    earlier = drawn_earlier(given.earlier, count, given.processes) if given.earlier else None
    shown = Shown(drawn, outlined(given.pictures), masked(given.pictures), earlier)
    network, teacher = Network(given.start), Network(given.start, ("old",)) if given.earlier else None
    train(network, shown, given.minutes, given.seed, teacher)
    network.save(given.model)
    print(f"{given.model}: {given.model.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
