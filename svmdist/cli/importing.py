"""`svmdist import`: images or video, a calibration, poses and joints, into a log."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Literal

from svmdist.cli.options import (
    EVERY,
    FORCE,
    LENGTH_UNITS_M,
    Options,
    argument,
    option,
    parse_length_m,
    parse_number,
)
from svmdist.cli.output import LOG, ExitCode, next_command, progress_bar, require_output
from svmdist.errors import UsageError

INSTRUMENT = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
SIZE = r"([1-9]\d{0,4})x([1-9]\d{0,4})"
CROP = r"(\d{1,5}),(\d{1,5}),([1-9]\d{0,4}),([1-9]\d{0,4})"


class Import(Options):
    """Write a log of images or a video.

    One view, two, or two side by side; calibrated by a file or in numbers; with tables of poses and joints.

    Examples:
      Images at 30 per second, of a camera in numbers:
        svmdist import images --rate 30 --camera 572,572,320,240 -o log.mcap
      Two views of a video side by side, with the pair's calibration:
        svmdist import video.mp4 --side-by-side --calibration stereo.yaml
      With joints of the robot, a column for each:
        svmdist import images --rate 30 --camera 572,572,320,240 --joints q.csv
    """

    source: Path = argument(..., "SOURCE", "Folder of images, or a video.")
    right: Path | None = argument(None, "RIGHT", "The right view: a folder or a video.")
    output: Path | None = option("--output -o FILE.mcap", "Log to write. Default: SOURCE.mcap.")
    pattern: str | None = option("--pattern GLOB", "Which images of the folder, as in '*_L.jpg'.")
    right_pattern: str | None = option("--right-pattern GLOB", "Those of the right view, as in '*_R.jpg'.")
    side_by_side: bool = option("--side-by-side", "Each picture has both views, the left one left.", False)
    camera_file: Path | None = option(
        "--calibration FILE", "Of ROS, OpenCV (YAML, XML) or Kalibr; may be of a pair."
    )
    right_calibration: Path | None = option("--right-calibration FILE", "The right camera's own.")
    calibrated_at: str | None = option("--calibrated-at SIZE", "If images were scaled since, as in 1280x720.")
    crop: str | None = option("--crop X,Y,WIDTH,HEIGHT", "This part of each view, in px of the whole.")
    camera: str | None = option("--camera FX,FY,CX,CY", "The camera in px, in place of a file.")
    right_camera: str | None = option("--right-camera FX,…", "The right one. Default: the left one.")
    distortion: str | None = option("--distortion K1,K2,…", "With --camera: K1,K2,P1,P2[,K3…].")
    distortion_model: str = option(
        "--distortion-model NAME", "plumb_bob (the default), rational_polynomial or fisheye.", "plumb_bob"
    )
    baseline_length: str | None = option(
        "--baseline LENGTH", "Between the cameras of a rectified pair, as in 5.2mm."
    )
    unit: Literal["m", "cm", "mm"] = option(
        "--unit UNIT", "Of lengths in calibration and poses: m (the default), cm, mm.", "m"
    )
    rate: float | None = option(
        "--rate HZ", "Images per second, if neither names nor video tell.", min=1e-3, max=1e4
    )
    start: str = option("--start SECONDS", "Time of the first image, with --rate or a video.", "0")
    times: Path | None = option("--times FILE.csv", "Times of the images, with or without their names.")
    poses: list[str] | None = option(
        "--poses [NAME=]FILE", "Tool poses in the base of NAME (PSM1); may be repeated."
    )
    joints: list[str] | None = option("--joints [NAME=]FILE", "Joint positions; may be repeated.")
    joint_names: str | None = option("--joint-names NAME,…", "Of columns of --joints without names.")
    every: int = EVERY
    jpeg: int | None = option(
        "--jpeg QUALITY", "Store what has to be decoded as JPEG. Default: PNG.", min=1, max=100
    )
    force: bool = FORCE

    def _run(self) -> ExitCode:
        from svmdist.importing.calibration import CalibrationOptions
        from svmdist.importing.tables import parse_stamp_ns
        from svmdist.workflows.import_log import ImportOptions, ViewOptions, import_log

        path = self.output or Path(f"{self.source.resolve().stem}.mcap")
        require_output(path)
        if self.right_camera is not None and self.camera is None:
            raise UsageError("--right-camera goes with --camera")
        if self.baseline_length is not None and not (self.right or self.right_pattern or self.side_by_side):
            raise UsageError("--baseline is of two views: name the right one, or say --side-by-side")
        try:
            start_ns = parse_stamp_ns(self.start, "s")
        except ValueError as problem:
            raise UsageError(f"--start {self.start}: {problem}") from None
        options = ImportOptions(
            ViewOptions(
                *(self.source, self.right, self.pattern, self.right_pattern, self.side_by_side),
                *(self.rate, start_ns, self.times, self.every),
                _whole_px("--crop", self.crop, CROP, "X,Y,WIDTH,HEIGHT, as in 40,0,640,480"),
            ),
            CalibrationOptions(
                (self.camera_file, self.right_calibration),
                (_intrinsics("--camera", self.camera), _intrinsics("--right-camera", self.right_camera)),
                _numbers("--distortion", self.distortion) if self.distortion else (),
                self.distortion_model,
                parse_length_m("--baseline", self.baseline_length) if self.baseline_length else None,
                LENGTH_UNITS_M[self.unit],
                _whole_px("--calibrated-at", self.calibrated_at, SIZE, "WIDTHxHEIGHT, as in 1280x720"),
            ),
            _tables("--poses", self.poses),
            _tables("--joints", self.joints),
            tuple(name.strip() for name in self.joint_names.split(",")) if self.joint_names else None,
            self.jpeg,
        )
        with progress_bar(f"import {self.source.name}", "images") as advance:
            result = import_log(options, path, force=self.force, on_progress=advance)
        counted = [f"{count} {topic}" for topic, count in result.counts.items() if "camera_info" not in topic]
        LOG.info("%s: %s; %.2f MB", path, ", ".join(counted), result.size_bytes / 1e6)
        if result.has_baseline is False:
            LOG.info("no baseline is known: stereo needs --baseline, or a calibration of the pair")
        for loss in result.losses:
            LOG.error("loss: %s", loss)
        if result.warning:
            LOG.warning("%s", result.warning)
        LOG.info("next: %s", next_command("profile", "new", path, "-o", f"{path.stem}.toml"))
        return ExitCode.LOSS if result.losses else ExitCode.CLEAN


def _numbers(name: str, text: str) -> tuple[float, ...]:
    numbers = tuple(map(parse_number, text.split(",")))
    if not all(map(math.isfinite, numbers)):
        raise UsageError(f"{name} {text}: expected numbers between commas")
    return numbers


def _whole_px(name: str, text: str | None, form: str, expected: str) -> Any:
    if text is None:
        return None
    if found := re.fullmatch(form, text):
        return tuple(map(int, found.groups()))
    raise UsageError(f"{name} {text}: expected {expected}, in px")


def _intrinsics(name: str, text: str | None) -> tuple[float, ...] | None:
    numbers = None if text is None else _numbers(name, text)
    if numbers is not None and (len(numbers) != 4 or min(numbers[:2]) <= 0):
        raise UsageError(f"{name} {text}: expected FX,FY,CX,CY in px, as in 572.2,572.2,378.8,239.3")
    return numbers


def _tables(name: str, given: list[str] | None) -> dict[str, Path]:
    """Files by the instrument's name."""
    found: dict[str, Path] = {}
    for text in given or []:
        instrument, equals, file = text.partition("=")
        if not (equals and INSTRUMENT.match(instrument)):
            instrument, file = "PSM1", text
        if instrument in found:
            raise UsageError(f"{name}: two files for the instrument {instrument}; name the other: NAME=FILE")
        found[instrument] = Path(file)
    return found
