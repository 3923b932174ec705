"""Remake the pictures of the documentation, each by the commands that stand below it on its page.

Run `uv run python -m benchmarks.pictures` for all, or with names such as `overlay` for some.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.generated_pages import DOCS, ROOT, named

IMAGES = DOCS / "images"
JPEG_QUALITY = 88
PICTURE = re.compile(r"^!\[[^\]]+\]\((?:docs/)?images/(\w[\w-]*\.(?:jpg|png))\)\n\n```console\n(.*?)^```$", re.M | re.S)


def printed_pictures() -> dict[str, list[str]]:
    """The commands of each picture, without `uv run`, in README.md and the pages of docs/."""
    pages = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
    found = (match for page in pages for match in PICTURE.finditer(page.read_text("utf-8")))
    return {match[1]: re.findall(r"^\$ uv run (.*)$", match[2], re.M) for match in found}


def make_picture(name: str, commands: list[str], folder: Path) -> None:
    """Run the commands in an empty folder. A frame's picture is kept as JPEG, a plot as it is."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "recordings").symlink_to(ROOT / "recordings")
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        for command in commands:
            subprocess.run(["bash", "-c", command], cwd=scratch, env=os.environ | {"PATH": path}, check=True)
        (made,) = Path(scratch).glob("*.png")
        if name.endswith(".png"):
            (folder / name).write_bytes(made.read_bytes())
        else:
            picture = np.asarray(cv2.imread(str(made)))
            cv2.imwrite(str(folder / name), picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


if __name__ == "__main__":
    by_stem = {Path(name).stem: (name, commands) for name, commands in printed_pictures().items()}
    for stem in named("picture", sys.argv[1:], by_stem):
        name, commands = by_stem[stem]
        print(name, *commands, sep="\n  ", file=sys.stderr)
        make_picture(name, commands, IMAGES)
