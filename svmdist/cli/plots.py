"""`--save-plot` and `--plot`: what each command can draw, and that it can, before the work."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from svmdist.cli.console import require_output
from svmdist.errors import UsageError


class PlotKind(StrEnum):
    """`--plot`."""

    FIG6 = "fig6"
    TIME = "time"
    RESIDUALS = "residuals"
    BLAND_ALTMAN = "bland-altman"
    CALIBRATION = "calibration"
    COMPARE = "compare"


PLOTS = {
    "estimate": (PlotKind.TIME,),
    "validate": (
        *(PlotKind.FIG6, PlotKind.TIME, PlotKind.RESIDUALS, PlotKind.BLAND_ALTMAN, PlotKind.CALIBRATION),
    ),
    "compare": (PlotKind.COMPARE,),
}
"""What each command draws; the first is drawn where none is asked for."""
MEANINGS = {
    PlotKind.FIG6: "fig6, truth, estimate and error over time as in the paper's figure",
    PlotKind.TIME: "time, the distance with its interval",
    PlotKind.RESIDUALS: "residuals over time and distance",
    PlotKind.BLAND_ALTMAN: "bland-altman",
    PlotKind.CALIBRATION: "calibration of the interval",
    PlotKind.COMPARE: "compare, methods side by side",
}


def _option(command: str) -> Any:
    kinds = PLOTS[command]
    meanings = "; ".join(MEANINGS[kind] for kind in kinds)
    return typer.Option(
        "--plot",
        metavar="|".join(kinds),
        autocompletion=lambda incomplete: [str(kind) for kind in kinds if kind.startswith(incomplete)],
        help=f"What --save-plot draws: {meanings}. Default: {kinds[0]}.",
        show_default=False,
    )


ValidatePlotOption = Annotated[PlotKind | None, _option("validate")]
ComparePlotOption = Annotated[PlotKind | None, _option("compare")]


def require_plot(
    command: str, kind: PlotKind | None, path: Path | None, inputs: Sequence[Path] = ()
) -> PlotKind | None:
    """What a command shall draw, None for nothing, checked before the work.

    Raises UsageError for a plot that another command draws, and for one without a file; OutputError for a file that
    cannot be written, or has another ending than png, svg or pdf.
    """
    if kind is not None and kind not in PLOTS[command]:
        own = " or ".join(PLOTS[command])
        of = next(other for other, kinds in PLOTS.items() if kind in kinds)
        raise UsageError(f"--plot {kind}: is drawn by svmdist {of}; svmdist {command} draws {own}")
    if path is None:
        if kind is not None:
            raise UsageError(f"--plot {kind}: says what --save-plot FILE draws, which is not given")
        return None
    from svmdist.report.writers import plot_format

    plot_format(path)
    require_output(path, inputs)
    return kind or PLOTS[command][0]
