"""The README's picture of a real instrument: `uv run python -m benchmarks.real.picture FOLDER [--out DIR]`.

FOLDER holds the set ReCoDE, as for `python -m benchmarks.real`. One image with its clearance stands beside the
clearances of all. Their interval is wide: the plane is the profile's, not measured.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.generated_pages import DOCS
from benchmarks.real import recode
from svmdist import open_recording, prepare
from svmdist.drawing import Part
from svmdist.report import charts
from svmdist.report.on_image import draw_on
from svmdist.report.plots import LOOKS
from svmdist.samples import Image
from svmdist.workflows.frame_drawing import DrawnFrame, drawn_frames

HEIGHT_PX, WIDTH_PX, DPI, LETTERS, JPEG_QUALITY = 640, 1600, 160, 1 / 44, 90
SHOWN, PARTS = 19, (Part.POSE, Part.TIP, Part.DISTANCE)
"""The image whose clearance is in view down to the plane, and what `kinematic` says of it."""


def plot(frames: list[DrawnFrame], width_px: int) -> Image:
    """The clearances over time with their 95% intervals, and a mark at the shown one."""
    found = [(one.seconds, one.replayed.results[0].distances.clearance) for one in frames]
    seconds, low, middle, high = np.array(
        [(at, of.interval_m[0], of.value_m, of.interval_m[1]) for at, of in found if of and of.interval_m]
    ).T * np.array([[1.0], [1e3], [1e3], [1e3]])
    colour = tuple(level / 255.0 for level in charts.COLOURS["estimate"])
    with mpl.rc_context(LOOKS | {"font.size": 10, "axes.titlesize": 10, "legend.fontsize": 10}):
        figure = Figure(figsize=(width_px / DPI, HEIGHT_PX / DPI), dpi=DPI, layout="constrained")
        axes = figure.add_subplot()
        axes.fill_between(seconds, low, high, color=colour, alpha=0.3, linewidth=0.0, label="95% interval")
        axes.plot(seconds, middle, color=colour, marker=".", label="clearance")
        axes.plot(seconds[SHOWN], middle[SHOWN], "o", color="0.0", markersize=9, fillstyle="none", label="the image")
        axes.set(xlabel="time [s]", ylabel="clearance [mm]")
        figure.legend(loc="outside upper center", ncols=3)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, 2::-1]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("real-images"))
    given = parser.parse_args()
    log, profile = recode.log_with_joints(given.folder, given.out / "recode")
    setup = prepare(profile, "kinematic")
    frames = list(drawn_frames(open_recording(log, profile), setup, jobs=1))
    shown = frames[SHOWN]
    image = np.asarray(shown.replayed.image_bgr)
    times = HEIGHT_PX / image.shape[0]
    drawn = draw_on(image, shown.drawing, parts=PARTS, lines=False, least_px=2 * image.shape[1], letters=LETTERS)
    left = cv2.resize(drawn, (round(image.shape[1] * times), HEIGHT_PX), interpolation=cv2.INTER_AREA)
    both = np.hstack([left, plot(frames, WIDTH_PX - left.shape[1])])
    cv2.imwrite(str(DOCS / "images" / "real.jpg"), both, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
