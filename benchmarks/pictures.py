"""Remake the pictures of the documentation, each by the command that its page shows beside it.

Run `uv run python -m benchmarks.pictures` for all, or with names such as `overlay` for some.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
JPEG_QUALITY = 88
PICTURES: dict[str, tuple[str, ...]] = {
    "scene.jpg": ("svmdist show recordings/3d/duo.mcap --frame 60 --method fused",),
    "overlay.jpg": ("svmdist show recordings/sweep.mcap --frame 30 --method overlay",),
    "auto.jpg": (
        "svmdist profile new recordings/3d/contact.mcap -o auto.toml",
        "svmdist show recordings/3d/contact.mcap --masks --frame 40 --profile auto.toml",
    ),
    "fiducial.jpg": ("svmdist show recordings/3d/contact.mcap --frame 20 --method fiducial",),
    "shaft.jpg": ("svmdist show recordings/3d/contact.mcap --frame 45 --method shaft",),
    "stereo.jpg": ("svmdist show recordings/3d/contact.mcap --frame 45 --method stereo",),
    "kinematic.png": (
        "svmdist validate recordings/3d/duo.mcap --method kinematic --truth ground_truth --save-plot kinematic.png",
    ),
    "fused.jpg": ("svmdist show recordings/real/random.mcap --frame 20 --method fused",),
    "instruments.jpg": ("svmdist show recordings/3d/duo.mcap --frame 25 --method fused",),
    "hand-eye.png": (
        "svmdist hand-eye recordings/3d/duo.mcap -o hand-eye.toml",
        "svmdist validate recordings/3d/duo.mcap --method kinematic --hand-eye hand-eye.toml --truth ground_truth"
        " --save-plot hand-eye.png",
    ),
    "validation.png": ("svmdist validate --save-plot validation.png",),
    "clearance.png": (
        "svmdist validate recordings/3d/*.mcap --method fused --alarm-below 5mm --truth ground_truth"
        " --save-plot clearance.png",
    ),
    "calibration.png": (
        "svmdist validate recordings/real/*.mcap --method fused --truth ground_truth --plot calibration"
        " --save-plot calibration.png",
    ),
}
"""The commands that make each picture, without `uv run`. A frame's picture is kept as JPEG, a plot as it is."""


def make_picture(name: str, folder: Path) -> None:
    """Run the commands of a picture in an empty folder, and store the picture there under its name."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "recordings").symlink_to(ROOT / "recordings")
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        for command in PICTURES[name]:
            subprocess.run(["bash", "-c", command], cwd=scratch, env=os.environ | {"PATH": path}, check=True)
        (made,) = Path(scratch).glob("*.png")
        if name.endswith(".png"):
            (folder / name).write_bytes(made.read_bytes())
            return
        picture = cv2.imread(str(made))
        assert picture is not None
        cv2.imwrite(str(folder / name), picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def main() -> None:
    """Remake all pictures, or those that are named."""
    by_stem = {Path(name).stem: name for name in PICTURES}
    for stem in sys.argv[1:] or by_stem:
        if stem not in by_stem:
            raise SystemExit(f"no picture {stem}: the choices are {', '.join(by_stem)}")
        for command in PICTURES[by_stem[stem]]:
            print(f"{by_stem[stem]}: {shlex.join(shlex.split(command))}", file=sys.stderr)
        make_picture(by_stem[stem], IMAGES)


if __name__ == "__main__":
    main()
