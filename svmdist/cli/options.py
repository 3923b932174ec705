"""Options, each declared once: groups of them that commands put together. Light to import: `svmdist --help` reads it.

A command is a class: it inherits the groups that it takes and adds its own options, and its docstring is the help.
"""

from __future__ import annotations

import inspect
import logging
import math
import os
import re
import time
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from svmdist.cli.output import LOG, progress_bar, require_output
from svmdist.errors import UsageError, did_you_mean, restated
from svmdist.report.writers import Holds, Writer, choose_writer, names_of

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.perturbations import Perturbations
    from svmdist.profile import Profile
    from svmdist.recording.observations import Window
    from svmdist.remote import LogPath
    from svmdist.workflows.request import Lag, Request, Setup

OUTPUTS = ("output", "report", "save_plot", "summary", "write_baseline")
INPUTS = ("profile", "calibration", "hand_eye", "estimates")
"""Options that name files to read; a baseline that was read may be written anew."""
LENGTH_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MAX_LAG_S = 3600.0


def option(names: str, text: str, default: Any = None, **more: Any) -> Any:
    """Declare an option: its names and what stands for its value, as in `--jobs -j N`, the help, and its default."""
    words = names.split()
    named = [word for word in words if word.startswith("-")]
    metavar = next((word for word in words if not word.startswith("-")), None)
    return typer.Option(default, *named, metavar=metavar, help=text, show_default=False, **more)


def argument(default: Any, metavar: str, text: str) -> Any:
    """Declare an argument; a default of ... makes it required."""
    return typer.Argument(default, metavar=metavar, help=text, show_default=False)


QUIET = option("--quiet -q", "Print only data and errors.", False)
VERBOSE = option("--verbose -v", "Also print which topics are read, and times.", False)


class Options(ABC):
    """Values of options by name; an annotated class attribute made by `option` or `argument` declares one."""

    quiet: bool = QUIET
    verbose: bool = VERBOSE

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)

    @abstractmethod
    def _run(self) -> int | None:
        """Run the command, and give its exit code; None is 0."""


def function_of(command: type[Options]) -> Callable[..., None]:
    """A function with a parameter for each option of a command, as Typer reads it."""

    def run(**values: Any) -> None:
        choose_verbosity(quiet=values["quiet"], verbose=values["verbose"])
        begin_s = time.perf_counter()
        given = command(**values)
        _require_files_apart(given)
        try:
            raise typer.Exit(given._run() or 0)
        finally:
            LOG.debug("%s took %.1f s", name_of(command), time.perf_counter() - begin_s)

    parameters = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=getattr(command, name), annotation=of)
        for name, of in typing.get_type_hints(command).items()
    ]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def _require_files_apart(given: Options) -> None:
    """Raise UsageError where two outputs are one file, one is an input, or is `-` and cannot go to stdout."""
    values = {key: value for key, value in vars(given).items() if key in OUTPUTS + INPUTS and value is not None}
    flags = {key: getattr(type(given), key).param_decls[-1] for key in values}
    read, written = dict[str, str](), dict[str, str]()
    for key in filter(values.__contains__, INPUTS):
        for text in map(str, values[key] if isinstance(values[key], list) else [values[key]]):
            files = filter(os.path.isfile, (text, text.partition("=")[2]))  # estimates may be NAME=FILE
            read.update((os.path.realpath(file), flags[key]) for file in files)
    for key in filter(values.__contains__, OUTPUTS):
        path, flag = values[key], flags[key]
        if path == Path("-"):  # where it is stdout, it was read as None
            raise UsageError(f"{flag} -: expected the name of a file; this is not written to stdout")
        if path.parent != Path("/dev"):
            place = os.path.realpath(path)
            if (other := written.setdefault(place, flag)) != flag:
                raise UsageError(f"{other} and {flag} are both {path}: give each a file of its own")
            if place in read:
                raise UsageError(f"{flag} {path}: is what {read[place]} reads; give the output another name")


def name_of(command: type[Options]) -> str:
    """The name of a command: `blur-bench` of BlurBench."""
    return re.sub(r"(?<=.)([A-Z])", r"-\1", command.__name__).lower()


def choose_verbosity(*, quiet: bool, verbose: bool) -> None:
    """Choose what is logged: errors only, or everything; else it stays as it is."""
    if quiet or verbose:
        LOG.setLevel(logging.ERROR if quiet else logging.DEBUG)


FORCE = option("--force", "Replace the file if it exists.", False)
JOBS = option("--jobs -j N", "Processes; results are the same. Default: all cores.", min=1, max=256)
PLOT = option("--save-plot FIG", "Plot to this file (png, svg, pdf).")
PROFILE = option("--profile NAME|FILE", "psm13, dvrk-psm, or a TOML file. Default: psm13.", "psm13")
CALIBRATION = option("--calibration FILE", "Planar mapping. Default: the profile's.")
EVERY = option("--every N", "Take every N-th image only.", 1, min=1)


def format_option(holds: Holds, default: str = ". Default: by the ending of the output, else ") -> Any:
    """Declare `--format`: the formats that can hold what a command gives, the first one where no file is named."""
    names = names_of(holds)
    return option(
        "--format -f NAME",
        f"{', '.join(names)}{default}{names[0]}.",
        autocompletion=lambda incomplete: [name for name in names if name.startswith(incomplete)],
    )


class OutputOptions(Options):
    """Where data goes, and in which format; a command of anything but tables declares the formats of its own."""

    form: str | None = format_option(Holds.TABLES)
    output: Path | None = option(
        "--output -o FILE",
        "File, its ending the format. Default, and -: stdout.",
        callback=lambda output: None if output == Path("-") else output,
    )

    def writer(self, inputs: Iterable[LogPath], holds: Holds) -> Writer:
        """What writes the data, checked before the work; raises UsageError or OutputError."""
        require_output(self.output, inputs)
        return choose_writer(self.form, self.output, holds)


class TopicOption(Options):
    """Which topics are read."""

    topic: list[str] | None = option(
        "--topic ROLE=TOPIC",
        "Read image, right_image, joints, pose, … of this topic, as in image=/cam/image_raw; may be repeated.",
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


class ReadOptions(TopicOption):
    """How a log is read."""

    profile: str = PROFILE
    hand_eye: Path | None = option("--hand-eye FILE", "Camera-to-base transforms of `svmdist hand-eye`.")


class WindowOptions(Options):
    """Which images are read."""

    start: float = option("--start SECONDS", "Begin so long after the first image.", 0.0, min=0.0)
    end: float | None = option("--end SECONDS", "End so long after the first image.", min=0.0)
    every: int = EVERY

    @property
    def window(self) -> Window:
        """The window that the options name; raises UsageError for one without any image."""
        from svmdist.recording.observations import Window

        return Window(self.start, math.inf if self.end is None else self.end, self.every)


class MethodOptions(ReadOptions):
    """What measures."""

    calibration: Path | None = CALIBRATION
    method: Literal["auto", "overlay", "centroid", "fiducial", "shaft", "stereo", "kinematic", "fused"] = option(
        "--method NAME",
        "auto: the best that the log can serve. In 3D: fiducial (tag), shaft, stereo (two cameras), kinematic,"
        " fused (all of these). In the plane: overlay (the paper's), centroid. Default: auto.",
        "auto",
    )
    _choice = ""

    def chosen_method(self, paths: Sequence[LogPath]) -> str:
        """The method that is asked for, or the best for these logs; raises ProfileError or UsageError."""
        if self.method != "auto":
            return self.method
        if self.calibration is not None or getattr(self, "equations", "corrected") == "printed":
            return "overlay"  # the others take neither
        from svmdist.profile import load_profile
        from svmdist.workflows.capabilities import best_method

        with progress_bar("choosing a method"):
            profile, has_lag = load_profile(self.profile, self.hand_eye), bool(getattr(self, "lag", None))
            method, why = best_method(paths, profile, self.topics, has_lag=has_lag)
        self._choice = f"method {method}: {why}"
        return method

    def say_choice(self) -> None:
        """Log which method was chosen, and why, where none was asked for."""
        if self._choice:
            LOG.info("%s", self._choice)


class InstrumentOption(Options):
    """Which instruments are measured."""

    instrument: list[str] | None = option("--instrument NAME", "Only this one of several; may be repeated.")

    def instruments(self, profile: Profile) -> tuple[str, ...] | None:
        """The instruments that were asked for, in the order of the profile, None for all; raises UsageError."""
        wanted = self.instrument or []
        for name in wanted:
            if name not in profile.instrument_names:
                known = did_you_mean(name, profile.instrument_names)
                raise UsageError(f"--instrument {name}: profile {profile.name} has no such instrument: {known}")
        return tuple(name for name in profile.instrument_names if name in wanted) or None


class LagOption(Options):
    """The time offset of the images."""

    lag: str | None = option("--lag auto|SECONDS", "Images are so late; auto estimates it. Default: 0.")

    @property
    def given_lag(self) -> Lag | None:
        """A number of seconds, auto, or None where no lag is given; raises UsageError."""
        if self.lag is None or self.lag == "auto":
            return self.lag  # type: ignore[return-value]
        lag_s = parse_number(self.lag)
        if not abs(lag_s) <= MAX_LAG_S:
            raise UsageError(f"--lag {self.lag}: expected auto or seconds within ±{MAX_LAG_S:g}, as in 0.12")
        return lag_s


class MeasureOptions(MethodOptions, InstrumentOption, LagOption, WindowOptions):
    """Everything of a measurement by one method."""

    equations: Literal["corrected", "printed"] = option(
        "--equations NAME", "corrected (the default), or printed as published.", "corrected"
    )
    alarm_below: str | None = option("--alarm-below LENGTH", "Alarm where the clearance may be below, as in 5mm.")
    alarm_when: str | None = option(
        "--alarm-when LEVEL",
        "possible (probability 0.05 or more), likely (0.5), certain (0.95), or a probability. Default: possible.",
    )
    alarm_confidence: float | None = option(
        "--alarm-confidence P", "The former name of --alarm-when P.", min=0.0, max=1.0, hidden=True
    )

    @property
    def alarms(self) -> AlarmRules | None:
        """The rules that are asked for, None without a threshold; raises UsageError."""
        levels: dict[str, Any] = {"--alarm-when": self.alarm_when, "--alarm-confidence": self.alarm_confidence}
        given = {name: level for name, level in levels.items() if level is not None}
        if len(given) > 1:
            raise UsageError("--alarm-confidence is the former name of --alarm-when: give one of them")
        if self.alarm_below is None:
            for name in given:
                raise UsageError(f"{name} is for --alarm-below LENGTH, as in --alarm-below 5mm")
            return None
        from svmdist.estimation.alarms import AlarmRules

        return AlarmRules(parse_length_m("--alarm-below", self.alarm_below), *given.values())

    def setup(self, paths: Sequence[LogPath]) -> Setup:
        """What measures these logs; raises ProfileError, CalibrationError or UsageError."""
        from svmdist.workflows.request import prepare

        return prepare(self.profile, self.chosen_method(paths), self.equations, self.calibration, self.hand_eye)

    def request(self, paths: Sequence[LogPath]) -> Request:
        """What is asked of each log, checked before the work; raises UsageError, ProfileError or CalibrationError."""
        from svmdist.workflows.capabilities import require_clearance
        from svmdist.workflows.request import Request

        lag, alarms, window, setup = self.given_lag, self.alarms, self.window, self.setup(paths)
        if alarms:
            require_clearance(setup)
        return Request(setup, self.topics, window, self.instruments(setup.profile), lag, alarms)


def parse_number(text: str) -> float:
    """A number, NaN for what is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def parse_length_m(name: str, text: str) -> float:
    """Parse a length with its unit, `5mm`, `0.5 cm`, `0.005m`, to m; raises UsageError."""
    found = re.fullmatch(r"(.*?)(mm|cm|m)", text.strip())
    length_m = parse_number(found[1]) * LENGTH_UNITS_M[found[2]] if found else math.nan
    if not 0.0 < length_m < 10.0:
        raise UsageError(f"{name} {text}: expected a length above zero with its unit (mm, cm or m), as in 5mm")
    return length_m


def parse_degradations(values: list[str] | None) -> tuple[tuple[str, int], ...]:
    """Parse NAME=SEVERITY of `--degrade`; raises UsageError. Name and range are checked where they are used."""
    parsed = []
    for value in values or []:
        kind, _, severity = value.partition("=")
        if not (kind and severity.isdecimal()):
            raise UsageError(f"--degrade {value}: expected NAME=SEVERITY, as in smoke=3")
        parsed.append((kind, int(severity)))
    return tuple(parsed)


def parse_perturbations(values: list[str] | None) -> tuple[Perturbations, ...]:
    """Parse NAME=STRENGTH of `--perturb`, several of one separated by commas; raises UsageError."""
    from svmdist.perturbations import parse_perturbations

    with restated(UsageError, UsageError, "--perturb: "):
        return tuple(map(parse_perturbations, values or []))
