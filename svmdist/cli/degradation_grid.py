"""`svmdist blur-bench --grid`: one method under every degradation and severity."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import Summary
from svmdist.cli.degradations import parse_names, parse_severities
from svmdist.cli.options import Method
from svmdist.cli.progress import progress_bar

if TYPE_CHECKING:
    from svmdist.cli.log_jobs import GridRuns
    from svmdist.cli.many import Outcomes
    from svmdist.recording.log import Recording
    from svmdist.workflows.conditions import Condition
    from svmdist.workflows.degradation_grid import GridCell
    from svmdist.workflows.request import Setup

GridMethodOption = Annotated[
    Method | None,
    typer.Option(
        "--method", help="With --grid: the method to measure. Default: overlay.", show_default=False
    ),
]
DegradationsOption = Annotated[
    str | None,
    typer.Option(
        "--degradations",
        metavar="NAME,...",
        help="With --grid: some of defocus, motion_blur, noise, low_light, specular, smoke, jpeg. Default: all.",
        show_default=False,
    ),
]
SeveritiesOption = Annotated[
    str | None,
    typer.Option(
        "--severities",
        metavar="N,...",
        help="With --grid: some of the severities 1 to 5. Default: all.",
        show_default=False,
    ),
]


def grid_conditions_of(degradations: str | None, severities: str | None) -> list[Condition]:
    """The conditions that the options ask for; raises UsageError."""
    from svmdist.vision.degradations import SEVERITIES, Degradation
    from svmdist.workflows.degradation_grid import grid_conditions

    return grid_conditions(
        list(Degradation) if degradations is None else parse_names("--degradations", degradations),
        SEVERITIES if severities is None else parse_severities("--severities", severities),
    )


def grid_summary(
    recordings: list[Recording],
    setup: Setup,
    conditions: list[Condition],
    jobs: int | None,
    save_plot: Path | None = None,
) -> Summary:
    """Measure with a progress bar, and make tables, rows, and the plot where one is asked for."""
    from svmdist.workflows.degradation_grid import degradation_grid

    with progress_bar(f"{setup.method}, {len(conditions)} conditions", "measurements") as advance:
        cells = degradation_grid(recordings, setup, conditions, jobs=jobs, on_progress=advance)
    return _summary(setup, cells, [(one.name, one.metadata) for one in recordings], save_plot)


def grid_summary_of_logs(
    outcomes: Outcomes[GridRuns],
    setup: Setup,
    conditions: list[Condition],
    save_plot: Path | None = None,
) -> Summary:
    """The same of many logs that were measured one by one."""
    from svmdist.workflows.degradation_grid import grid_cells

    runs = [run for _, result in outcomes.measured for run in result.runs]
    logs = [(one.log.name, one.metadata) for one, _ in outcomes.measured]
    return _summary(setup, grid_cells(runs, setup, conditions), logs, save_plot)


def _summary(
    setup: Setup,
    cells: list[GridCell],
    logs: list[tuple[str, Mapping[str, str]]],
    save_plot: Path | None,
) -> Summary:
    from svmdist.report.scores import FIGURE_NOTE, grid_keys, grid_row, grid_table, recorded_notes
    from svmdist.report.tables import counted

    if save_plot:
        from svmdist.report.plots import save_blur_plot

        save_blur_plot(cells, save_plot)
    title = f"{setup.method} on {cells[0].figures.frame_count} frames of {counted(len(logs), 'recording')}"
    notes = [FIGURE_NOTE, *recorded_notes(logs)]
    return Summary([grid_table(title, cells)], grid_keys(), [grid_row(cell) for cell in cells], notes)
