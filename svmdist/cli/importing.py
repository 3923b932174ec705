"""`svmdist import`: images or video, a calibration, poses and joints, into a log."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import require_output, say
from svmdist.cli.options import parse_length_m
from svmdist.cli.progress import progress_bar
from svmdist.errors import UsageError, did_you_mean

UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
INSTRUMENT = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def import_command(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Folder of images, or a video.", show_default=False)
    ],
    right: Annotated[
        Path | None,
        typer.Argument(metavar="RIGHT", help="The right view: a folder or a video.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.mcap",
            help="Log to write. Default: SOURCE.mcap.",
            show_default=False,
        ),
    ] = None,
    pattern: Annotated[
        str | None,
        typer.Option(
            "--pattern",
            metavar="GLOB",
            help="Which images of the folder, as in '*_L.jpg'.",
            show_default=False,
        ),
    ] = None,
    right_pattern: Annotated[
        str | None,
        typer.Option(
            "--right-pattern",
            metavar="GLOB",
            help="Which images are the right view, as in '*_R.jpg'; without RIGHT, of the same folder.",
            show_default=False,
        ),
    ] = None,
    side_by_side: Annotated[
        bool,
        typer.Option(
            "--side-by-side", help="Each picture has the left view on its left half, the right one beside."
        ),
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            metavar="FILE.yaml",
            help="camera_info of ROS, OpenCV's or Kalibr's calibration, of one camera or a pair.",
            show_default=False,
        ),
    ] = None,
    right_calibration: Annotated[
        Path | None,
        typer.Option(
            "--right-calibration",
            metavar="FILE.yaml",
            help="The right camera's, in a file of its own.",
            show_default=False,
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="FX,FY,CX,CY",
            help="The camera in px, in place of a file.",
            show_default=False,
        ),
    ] = None,
    right_camera: Annotated[
        str | None,
        typer.Option(
            "--right-camera",
            metavar="FX,FY,CX,CY",
            help="The right one. Default: as the left one.",
            show_default=False,
        ),
    ] = None,
    distortion: Annotated[
        str | None,
        typer.Option(
            "--distortion",
            metavar="K1,K2,P1,P2[,K3…]",
            help="With --camera. Default: none.",
            show_default=False,
        ),
    ] = None,
    distortion_model: Annotated[
        str,
        typer.Option("--distortion-model", metavar="NAME", help="plumb_bob, rational_polynomial or fisheye."),
    ] = "plumb_bob",
    baseline: Annotated[
        str | None,
        typer.Option(
            "--baseline",
            metavar="LENGTH",
            help="Distance of the cameras of a rectified pair, as in 5.2mm; in place of what a file says.",
            show_default=False,
        ),
    ] = None,
    unit: Annotated[
        str,
        typer.Option("--unit", metavar="UNIT", help="Unit of lengths in calibration and poses: m, cm or mm."),
    ] = "m",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="HZ",
            help="Images per second, where neither names nor video tell the time.",
            show_default=False,
        ),
    ] = None,
    start: Annotated[
        str,
        typer.Option("--start", metavar="SECONDS", help="Time of the first image, with --rate or a video."),
    ] = "0",
    times: Annotated[
        Path | None,
        typer.Option(
            "--times",
            metavar="FILE.csv",
            help="Times of the images: a column of times, or of names and times.",
            show_default=False,
        ),
    ] = None,
    poses: Annotated[
        list[str] | None,
        typer.Option(
            "--poses",
            metavar="[NAME=]FILE.csv",
            help="Poses of the tool in the robot's base, of instrument NAME (PSM1); may be repeated.",
            show_default=False,
        ),
    ] = None,
    joints: Annotated[
        list[str] | None,
        typer.Option(
            "--joints",
            metavar="[NAME=]FILE.csv",
            help="Joint positions; may be repeated.",
            show_default=False,
        ),
    ] = None,
    joint_names: Annotated[
        str | None,
        typer.Option(
            "--joint-names",
            metavar="NAME,…",
            help="Of the columns of --joints that have none.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[int, typer.Option("--every", metavar="N", min=1, help="Take each Nth image only.")] = 1,
    jpeg: Annotated[
        int | None,
        typer.Option(
            "--jpeg",
            metavar="QUALITY",
            min=1,
            max=100,
            help="Store what has to be decoded (video, side by side) as JPEG. Default: PNG, without loss.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the log if it exists.")] = False,
) -> None:
    """Write a log of images or a video.

    Views may be one, two, or two side by side. The calibration is a file's or given in numbers. Tables of poses and
    joints go into the log, too. PNG and JPEG files are stored as they are.
    """
    from svmdist.importing.calibration import CalibrationOptions
    from svmdist.workflows.import_log import ImportOptions, ViewOptions, import_log

    if rate is not None and not 1e-3 <= rate <= 1e4:
        raise UsageError(f"--rate {rate:g}: expected images per second, from 0.001 to 10000")
    if unit not in UNITS_M:
        raise UsageError(f"--unit {unit}: {did_you_mean(unit, UNITS_M)}")
    path = output or Path(f"{source.resolve().stem}.mcap")
    require_output(path)
    if right_camera is not None and camera is None:
        raise UsageError("--right-camera goes with --camera")
    if baseline is not None and right is None and right_pattern is None and not side_by_side:
        raise UsageError("--baseline is of two views: name the right one, or say --side-by-side")
    options = ImportOptions(
        ViewOptions(
            source, right, pattern, right_pattern, side_by_side, rate, _start_ns(start), times, every
        ),
        CalibrationOptions(
            (calibration, right_calibration),
            (_intrinsics("--camera", camera), _intrinsics("--right-camera", right_camera)),
            _numbers("--distortion", distortion) if distortion else (),
            distortion_model,
            parse_length_m("--baseline", baseline) if baseline else None,
            UNITS_M[unit],
        ),
        _tables("--poses", poses),
        _tables("--joints", joints),
        tuple(name.strip() for name in joint_names.split(",")) if joint_names else None,
        jpeg,
    )
    with progress_bar(f"import {source.name}", "images") as advance:
        result = import_log(options, path, force=force, on_progress=advance)
    counted = ", ".join(
        f"{count} {topic}" for topic, count in result.counts.items() if "camera_info" not in topic
    )
    say(f"svmdist: {path}: {counted}; {result.size_bytes / 1e6:.2f} MB")
    if result.has_baseline is False:
        say(
            "svmdist: no baseline is known: stereo cannot measure; give --baseline, or a calibration of the pair"
        )


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option} {text}: expected numbers between commas")
    return numbers


def _intrinsics(option: str, text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    numbers = _numbers(option, text)
    if len(numbers) != 4 or min(numbers[:2]) <= 0:
        raise UsageError(f"{option} {text}: expected FX,FY,CX,CY in px, as in 572.2,572.2,378.8,239.3")
    return numbers


def _start_ns(text: str) -> int:
    from svmdist.importing.tables import parse_stamp_ns

    try:
        return parse_stamp_ns(text, "s")
    except ValueError as problem:
        raise UsageError(f"--start {text}: {problem}") from None


def _tables(option: str, given: list[str] | None) -> dict[str, Path]:
    """Files by the instrument's name."""
    found: dict[str, Path] = {}
    for text in given or []:
        name, equals, file = text.partition("=")
        if not (equals and INSTRUMENT.match(name)):
            name, file = "PSM1", text
        if name in found:
            raise UsageError(f"{option}: two files for the instrument {name}; say NAME=FILE for another one")
        found[name] = Path(file)
    return found
