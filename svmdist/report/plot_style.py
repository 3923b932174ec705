"""How plots for print look, and how their files are written: at the width of a column or a page, without colour too."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from svmdist.errors import OutputError
from svmdist.files import atomic_file
from svmdist.report.text import printable

COLUMN_IN, PAGE_IN, PANEL_IN = 3.5, 7.16, 2.2
"""Widths of a column and of a page in print, and the height of a panel, in inches."""
DPI = 300
FORMATS = ("png", "svg", "pdf")
MARKERS = "osD^v<>Ph*Xd"
"""Markers that differ at a size of 4 points, in the order in which they are taken."""
GREYS = ("0.0", "0.35", "0.6")
DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (2, 1)), (0, (8, 3)))
LOOKS: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "svg.hashsalt": "svmdist",  # ids would differ between two runs on the same data
}


def plot_format(path: Path) -> str:
    """The format of a path's ending; raises OutputError, which lists the choices, for another one."""
    suffix = path.suffix.lstrip(".").lower()
    if suffix not in FORMATS:
        found = f"a .{suffix}" if suffix else "a file without an ending"
        raise OutputError(f"{path}: cannot draw {found}: the choices are {', '.join(FORMATS)}")
    return suffix


@contextmanager
def print_looks() -> Iterator[None]:
    """Within this, figures are made and drawn with the looks of print; settings outside stay as they are."""
    with mpl.rc_context(LOOKS), warnings.catch_warnings():
        # A name may hold letters that the font lacks: a box is drawn, which is no news to the user.
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from font", UserWarning)
        yield


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the path's ending; raises OutputError where that cannot be."""
    suffix = plot_format(path)
    metadata = {"Date": None} if suffix == "svg" else None
    with print_looks(), atomic_file(path) as target:
        figure.savefig(target, dpi=DPI, format=suffix, metadata=metadata)


def plain_name(text: str) -> str:
    """A name out of a file as matplotlib may print it: a dollar sign must not start a formula."""
    return printable(text).replace("$", r"\$").strip()
