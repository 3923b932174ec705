"""Arguments and options that several commands share. Light to import: `svmdist --help` reads it."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds, names_of

if TYPE_CHECKING:
    from svmdist.profile import Profile


class Method(StrEnum):
    """`--method`: the paper's, its ablation, and those in 3D."""

    OVERLAY = "overlay"
    CENTROID = "centroid"
    FIDUCIAL = "fiducial"
    SHAFT = "shaft"
    STEREO = "stereo"
    KINEMATIC = "kinematic"
    FUSED = "fused"


class PlanarMethod(StrEnum):
    """`--method` where only the paper's and its ablation make sense."""

    OVERLAY = "overlay"
    CENTROID = "centroid"


class EquationsChoice(StrEnum):
    """`--equations`: the readings of the paper's formulas."""

    CORRECTED = "corrected"
    PRINTED = "printed"


Files = Annotated[
    list[str],
    typer.Argument(
        metavar="FILE",
        help="Recordings: MCAP files, ROS 1 bags, rosbag2 folders, folders of these, globs or URLs.",
        show_default=False,
    ),
]
OptionalFiles = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FILE",
        help="Recordings, folders, globs or URLs. Default: every .mcap file in recordings/.",
        show_default=False,
    ),
]
TopicOption = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=TOPIC",
        help="Topic for a role, instead of the profile's; may be repeated. Roles: image, camera_info, right_image,"
        " right_camera_info, joints, pose, tf, ground_truth_tf, ground_truth_distance.",
        show_default=False,
    ),
]
InstrumentOption = Annotated[
    list[str] | None,
    typer.Option(
        "--instrument",
        metavar="NAME",
        help="Measure only this instrument of a log with several; may be repeated. Default: all.",
        show_default=False,
    ),
]
MethodOption = Annotated[
    Method,
    typer.Option(
        "--method",
        help="Planar: overlay (the paper's virtual marker) and centroid (the same without the marker)."
        " In 3D: fiducial (tag), shaft, stereo (two cameras), kinematic, and fused (all of them).",
    ),
]
EquationsOption = Annotated[
    EquationsChoice,
    typer.Option(
        "--equations", help="Reading of the paper's formulas: corrected, or printed, that is as published."
    ),
]
ProfileOption = Annotated[
    str,
    typer.Option(
        "--profile", metavar="NAME|FILE", help="Scene profile: the name of one that ships, or a TOML file."
    ),
]
HandEyeOption = Annotated[
    Path | None,
    typer.Option(
        "--hand-eye",
        metavar="FILE",
        help="Camera-to-base transforms of `svmdist hand-eye`, in place of the profile's and the log's.",
        show_default=False,
    ),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="Calibration file. Default: the one that ships with the profile.",
        show_default=False,
    ),
]


def _stdout_for_dash(output: Path | None) -> Path | None:
    """`-o -` is stdout."""
    return None if output == Path("-") else output


OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Write the data to this file instead of stdout, in the format of its ending; - is stdout.",
        callback=_stdout_for_dash,
        show_default=False,
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        min=1,
        max=256,
        help="Logs, frames or conditions to work on at a time. The results are the same. Default: the usable cores.",
        show_default=False,
    ),
]
LagOption = Annotated[
    str | None,
    typer.Option(
        "--lag",
        metavar="auto|SECONDS",
        help="Lag of the image stamps, positive where they are late; auto estimates it. Joints are looked up there."
        " Default: none is taken off.",
        show_default=False,
    ),
]
PlotOption = Annotated[
    Path | None,
    typer.Option(
        "--save-plot",
        metavar="FIG",
        help="Plot to this file (png, svg, pdf).",
        show_default=False,
    ),
]
ReportOption = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE.html",
        help="Write a report with interactive plots and the worst frames to this file; it needs no network.",
        show_default=False,
    ),
]
MAX_LAG_S = 3600.0


def format_option(holds: Holds) -> Any:
    """`--format` of a command: the formats that can hold what it gives, the first one where no file is named."""
    names = names_of(holds)
    return typer.Option(
        "--format",
        "-f",
        metavar="|".join(names),
        autocompletion=lambda incomplete: [name for name in names if name.startswith(incomplete)],
        help=f"Format of the data. Default: by the ending of the output file, else {names[0]}.",
        show_default=False,
    )


TableFormatOption = Annotated[str | None, format_option(Holds.TABLES)]
SummaryFormatOption = Annotated[str | None, format_option(Holds.FIGURES)]
RowFormatOption = Annotated[str | None, format_option(Holds.ROWS)]
PoseFormatOption = Annotated[str | None, format_option(Holds.POSES)]


def topics_of(options: list[str] | None) -> dict[str, str]:
    """Parse ROLE=TOPIC options; raises UsageError. Whether the role exists is checked when a log is opened."""
    topics = {}
    for option in options or []:
        role, equals, topic = option.partition("=")
        if not (role and equals and topic):
            raise UsageError(f"--topic {option}: expected ROLE=TOPIC, as in image=/left/image_raw")
        topics[role] = topic
    return topics


def instruments_of(options: list[str] | None, profile: Profile) -> tuple[str, ...] | None:
    """The instruments that were asked for, in the order of the profile, None for all; raises UsageError."""
    if not options:
        return None
    for name in options:
        if name not in profile.instrument_names:
            known = did_you_mean(name, profile.instrument_names)
            raise UsageError(f"--instrument {name}: profile {profile.name} has no such instrument: {known}")
    return tuple(name for name in profile.instrument_names if name in options)


def parse_lag(text: str | None) -> float | Literal["auto"] | None:
    """A number of seconds, auto, or None where no lag is given; raises UsageError."""
    if text is None:
        return None
    if text == "auto":
        return "auto"
    try:
        lag_s = float(text)
    except ValueError:
        lag_s = math.nan
    if not abs(lag_s) <= MAX_LAG_S:
        raise UsageError(f"--lag {text}: expected auto or seconds within ±{MAX_LAG_S:g}, as in 0.12")
    return lag_s


LENGTH_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def parse_length_m(option: str, text: str) -> float:
    """Parse a length with its unit, `5mm`, `0.5 cm`, `0.005m`, to m; raises UsageError."""
    plain = text.strip()
    for unit, scale in LENGTH_UNITS_M.items():
        number = plain.removesuffix(unit)
        if number == plain:
            continue
        try:
            length_m = float(number) * scale
        except ValueError:
            break
        if 0.0 < length_m < 10.0:
            return length_m
        break
    raise UsageError(f"{option} {text}: expected a length above zero with its unit (mm, cm or m), as in 5mm")
