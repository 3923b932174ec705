"""Options, each declared once: groups of them that commands put together. Light to import: `svmdist --help` reads it.

A command is a function of one object, whose class inherits the groups that it takes and adds its own options.
"""

from __future__ import annotations

import inspect
import logging
import math
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds, names_of

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.perturbations.chosen import Perturbations
    from svmdist.profile import Profile
    from svmdist.recording.observations import Window
    from svmdist.workflows.request import Lag, Request


class Options:
    """Values of options by name; a class attribute made by `option` or `argument` declares one."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)


def option(default: Any, names: str, text: str, **more: Any) -> Any:
    """Declare an option: its default, its names and what stands for its value, as in `--jobs -j N`, and the help."""
    words = names.split()
    named = [word for word in words if word.startswith("-")]
    metavar = next((word for word in words if not word.startswith("-")), None)
    return typer.Option(default, *named, metavar=metavar, help=text, **more)


def argument(default: Any, metavar: str, text: str) -> Any:
    """Declare an argument; a default of ... makes it required."""
    return typer.Argument(default, metavar=metavar, help=text, show_default=False)


def command_of(function: Callable[[Any], None]) -> Callable[..., None]:
    """A function with a parameter for each option of its only parameter's class, as Typer reads it."""
    group = typing.get_type_hints(function)["given"]
    hints = typing.get_type_hints(group)

    def command(**values: Any) -> None:
        choose_verbosity(quiet=values.pop("quiet"), verbose=values.pop("verbose"))
        function(group(**values))

    defaults = {name: getattr(group, name) for name in _names(group)} | {"quiet": QUIET, "verbose": VERBOSE}
    hints |= {"quiet": bool, "verbose": bool}
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[name])
            for name, default in defaults.items()
        ]
    )
    command.__annotations__ = {name: hints[name] for name in defaults}
    command.__doc__ = inspect.getdoc(function)
    return command


def _names(group: type) -> list[str]:
    """The options of a class in the order of its groups, its own last."""
    inherited = [name for base in group.__bases__ for name in _names(base)]
    own = inspect.get_annotations(group)
    return list(dict.fromkeys([*inherited, *own]))


QUIET = option(False, "--quiet -q", "Print only data and errors.")
VERBOSE = option(False, "--verbose -v", "Also print which topics are read, and the time taken.")


def choose_verbosity(*, quiet: bool, verbose: bool) -> None:
    """Choose what is logged: errors only, or everything; else it stays as it is."""
    if quiet or verbose:
        logging.getLogger("svmdist").setLevel(logging.ERROR if quiet else logging.DEBUG)


Method = Literal["overlay", "centroid", "fiducial", "shaft", "stereo", "kinematic", "fused"]
PlanarMethod = Literal["overlay", "centroid"]


def format_option(holds: Holds, more: str = "") -> Any:
    """Declare `--format`: the formats that can hold what a command gives, the first one where no file is named."""
    names = names_of(holds)
    return option(
        None,
        f"--format -f {'|'.join(names)}",
        f"Format of the data{more}. Default: by the ending of the output file, else {names[0]}.",
        autocompletion=lambda incomplete: [name for name in names if name.startswith(incomplete)],
    )


def _stdout_for_dash(output: Path | None) -> Path | None:
    return None if output == Path("-") else output


def output_option(metavar: str = "FILE", text: str = "", default: Any = None) -> Any:
    """Declare `--output`; without a text of its own it is data that goes to stdout by default."""
    to_file = "Write the data to this file instead of stdout, in the format of its ending; - is stdout."
    callback = None if text else _stdout_for_dash
    return option(default, f"--output -o {metavar}", text or to_file, callback=callback)


FORCE = option(False, "--force", "Replace the file if it exists.")
JOBS = option(
    None,
    "--jobs -j N",
    "Logs, frames or conditions to work on at a time. The results are the same. Default: the usable cores.",
    min=1,
    max=256,
)


class LogOptions(Options):
    """Logs, and where they are measured."""

    files: list[str] = argument(
        ..., "FILE", "Recordings: MCAP files, ROS 1 bags, rosbag2 folders, folders of these, globs or URLs."
    )
    jobs: int | None = JOBS
    scheduler: str | None = option(
        None,
        "--scheduler tcp://HOST:PORT",
        "Measure on this Dask cluster, one task per log; its workers read the same paths or URLs.",
    )
    resume: Path | None = option(
        None,
        "--resume FOLDER",
        "Keep each log's result in this folder, and reuse those of the same log, request and version.",
    )


class GoldenLogOptions(LogOptions):
    """The same, with logs that are measured where none is named."""

    files: list[str] | None = argument(  # type: ignore[assignment]
        None, "FILE", "Recordings, folders, globs or URLs. Default: every .mcap file in recordings/."
    )


class TopicOption(Options):
    """Which topics are read."""

    topic: list[str] | None = option(
        None,
        "--topic ROLE=TOPIC",
        "Topic for a role, instead of the profile's; may be repeated. Roles: image, camera_info, right_image,"
        " right_camera_info, joints, pose, tf, ground_truth_tf, ground_truth_distance.",
    )

    @property
    def topics(self) -> dict[str, str]:
        """The topics by role; raises UsageError. Whether a role exists is checked when a log is opened."""
        found = {}
        for text in self.topic or []:
            role, equals, topic = text.partition("=")
            if not (role and equals and topic):
                raise UsageError(f"--topic {text}: expected ROLE=TOPIC, as in image=/left/image_raw")
            found[role] = topic
        return found


class ProfileOptions(TopicOption):
    """How a log is read."""

    profile: str = option(
        "psm13", "--profile NAME|FILE", "Scene profile: the name of one that ships, or a TOML file."
    )


class ReadOptions(ProfileOptions):
    """The same, with camera-to-base transforms."""

    hand_eye: Path | None = option(
        None,
        "--hand-eye FILE",
        "Camera-to-base transforms of `svmdist hand-eye`, in place of the profile's and the log's.",
    )


class WindowOptions(Options):
    """Which images are read."""

    start: float = option(0.0, "--start SECONDS", "Seconds after the first image to begin at.", min=0.0)
    end: float | None = option(None, "--end SECONDS", "Seconds after the first image to end at.", min=0.0)
    every: int = option(1, "--every N", "Take every N-th image only.", min=1)

    @property
    def window(self) -> Window | None:
        """The window that the options name, None for all images; raises UsageError for one without any."""
        if (self.start, self.end, self.every) == (0.0, None, 1):
            return None
        if self.end is not None and self.end < self.start:
            raise UsageError(f"--end {self.end:g}: is before --start {self.start:g}")
        from svmdist.recording.observations import Window

        return Window(self.start, math.inf if self.end is None else self.end, self.every)


class CalibrationOption(Options):
    """The planar methods' mapping."""

    calibration: Path | None = option(
        None, "--calibration FILE", "Calibration file. Default: the one that ships with the profile."
    )


class MethodOptions(CalibrationOption):
    """What measures."""

    method: Method = option(
        "overlay",
        "--method",
        "Planar: overlay (the paper's virtual marker) and centroid (the same without the marker)."
        " In 3D: fiducial (tag), shaft, stereo (two cameras), kinematic, and fused (all of them).",
    )


class InstrumentOption(Options):
    """Which instruments are measured."""

    instrument: list[str] | None = option(
        None,
        "--instrument NAME",
        "Measure only this instrument of a log with several; may be repeated. Default: all.",
    )

    def instruments(self, profile: Profile) -> tuple[str, ...] | None:
        """The instruments that were asked for, in the order of the profile, None for all; raises UsageError."""
        for name in self.instrument or []:
            if name not in profile.instrument_names:
                known = did_you_mean(name, profile.instrument_names)
                raise UsageError(
                    f"--instrument {name}: profile {profile.name} has no such instrument: {known}"
                )
        return tuple(name for name in profile.instrument_names if name in (self.instrument or [])) or None


class LagOption(Options):
    """The time offset of the images."""

    lag: str | None = option(
        None,
        "--lag auto|SECONDS",
        "Lag of the image stamps, positive where they are late; auto estimates it. Joints are looked up there."
        " Default: no correction.",
    )

    @property
    def given_lag(self) -> Lag | None:
        """A number of seconds, auto, or None where no lag is given; raises UsageError."""
        if self.lag is None or self.lag == "auto":
            return self.lag  # type: ignore[return-value]
        try:
            lag_s = float(self.lag)
        except ValueError:
            lag_s = math.nan
        if not abs(lag_s) <= MAX_LAG_S:
            raise UsageError(f"--lag {self.lag}: expected auto or seconds within ±{MAX_LAG_S:g}, as in 0.12")
        return lag_s


MAX_LAG_S = 3600.0


class AlarmOptions(Options):
    """When an alarm is raised."""

    alarm_below: str | None = option(
        None,
        "--alarm-below LENGTH",
        "Raise an alarm where the clearance is below this, as in 5mm. For methods that estimate a clearance.",
    )
    alarm_confidence: float | None = option(
        None,
        "--alarm-confidence P",
        "Alarm where the clearance is below the threshold with at least this probability."
        " Default 0.05: alarm unless the frame is safe with 95 % probability.",
        min=0.0,
        max=1.0,
    )

    def rules(self, method: str) -> AlarmRules | None:
        """The rules that are asked for, None without a threshold; raises UsageError.

        A confidence without a threshold is refused, and so is a method that estimates no clearance.
        """
        if self.alarm_below is None:
            if self.alarm_confidence is not None:
                raise UsageError("--alarm-confidence is for --alarm-below LENGTH, as in --alarm-below 5mm")
            return None
        from svmdist.estimation.alarms import AlarmRules
        from svmdist.workflows.scores import require_clearance

        below_m = parse_length_m("--alarm-below", self.alarm_below)
        require_clearance(method)
        confidence = self.alarm_confidence
        return AlarmRules(below_m) if confidence is None else AlarmRules(below_m, confidence)


class GroupOption(Options):
    """How logs are grouped."""

    group: str | None = option(
        None,
        "--group KEY,...",
        "Also give figures for each group of logs, by their metadata, as in scenario,world.",
    )

    @property
    def group_keys(self) -> tuple[str, ...]:
        """The keys of `--group`; raises UsageError for none."""
        if self.group is None:
            return ()
        keys = tuple(key.strip() for key in self.group.split(","))
        if not all(keys):
            raise UsageError(f"--group {self.group}: expected names of metadata, as in scenario,world")
        return keys


def group_name(metadata: Mapping[str, str], keys: Sequence[str]) -> str:
    """What a log is grouped as: `scenario=sweep world=real`; a key that it does not have is `none`."""
    return " ".join(f"{key}={metadata.get(key, 'none')}" for key in keys)


class MeasureOptions(MethodOptions, ReadOptions, InstrumentOption, LagOption, AlarmOptions, WindowOptions):
    """Everything of a measurement by one method."""

    equations: Literal["corrected", "printed"] = option(
        "corrected",
        "--equations",
        "Reading of the paper's formulas: corrected, or printed, that is as published.",
    )

    def request(self) -> Request:
        """What is asked of each log, checked before the work; raises UsageError, ProfileError or CalibrationError."""
        from svmdist.workflows.request import Request, prepare
        from svmdist.workflows.scores import require_clearance

        lag, alarms, window = self.given_lag, self.rules(self.method), self.window
        setup = prepare(self.profile, self.method, self.equations, self.calibration, self.hand_eye)
        if alarms:
            require_clearance(setup.method, setup.profile)
        wanted = self.instruments(setup.profile)
        return Request(setup, self.topics, window, wanted, lag, alarms)


PLOT = option(None, "--save-plot FIG", "Plot to this file (png, svg, pdf).")
REPORT = option(
    None,
    "--report FILE.html",
    "Write a report with interactive plots and the worst frames to this file; it needs no network.",
)
LENGTH_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def parse_length_m(name: str, text: str) -> float:
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
    raise UsageError(f"{name} {text}: expected a length above zero with its unit (mm, cm or m), as in 5mm")


def parse_degradations(name: str, values: list[str] | None) -> tuple[tuple[str, int], ...]:
    """Parse NAME=SEVERITY values; raises UsageError. Name and range are checked where they are used."""
    parsed = []
    for value in values or []:
        kind, _, severity = value.partition("=")
        if not (kind and severity.isdecimal()):
            raise UsageError(f"{name} {value}: expected NAME=SEVERITY, as in smoke=3")
        parsed.append((kind, int(severity)))
    return tuple(parsed)


def parse_perturbations(name: str, values: list[str] | None) -> tuple[Perturbations, ...]:
    """Parse NAME=STRENGTH values, several of one separated by commas; raises UsageError."""
    from svmdist.perturbations import chosen

    try:
        return tuple(chosen.parse_perturbations(value) for value in values or [])
    except UsageError as problem:
        raise UsageError(f"{name}: {problem}") from None
