"""`svmdist record`, `import` and `profile new`: logs of a simulated scene or of images, and a profile of a log."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from svmdist.cli import options, output
from svmdist.cli.logs import OneLogOptions
from svmdist.cli.options import argument, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import UsageError, restated
from svmdist.files import files_of

if TYPE_CHECKING:
    from svmdist.workflows.record import Episodes

LARGE_BYTES, MANY_TIMES = 10e6, 3.0  # a log of so much, and so many times its source, is worth a hint
SIZE = r"([1-9]\d{0,4})x([1-9]\d{0,4})"
CROP = r"(\d{1,5}),(\d{1,5}),([1-9]\d{0,4}),([1-9]\d{0,4})"


class Record(options.Options):
    """Simulate the robot and write a recording.

    The recording holds images, joint states, the robot's nominal transforms, and ground truth.

    Examples:
      Eight seconds in which the tool touches the tissue:
        svmdist record --scenario contact
      Two cameras, a tag, and errors as real robots have them:
        svmdist record --stereo --tag --world real --seed 7 -o real-7.mcap
    """

    scenario: Literal["calibration", "sweep", "approach", "contact", "occlusion", "random"] = option(
        "--scenario NAME", "calibration, sweep (the default), approach, contact, occlusion or random.", "sweep"
    )
    seed: int = option("--seed N", "Of all that is random. Default: 1.", 1, min=0)
    duration: float = option("--duration SECONDS", "Default: 8.", 8.0, min=0.2, max=3600.0)
    images_per_second: float = option("--rate HZ", "Images per second. Default: 10.", 10.0, min=0.5, max=60.0)
    noise: float = option(
        "--noise LEVELS", "Sensor noise (standard deviation), in 8-bit levels.", 0.0, min=0.0, max=50.0
    )
    stereo: bool = option("--stereo", "Add the right camera.", False)
    tag: bool = option("--tag", "Mount the profile's AprilTag plate.", False)
    arms: int = option("--arms N", "Instruments: 1, or 2 that cross in the image.", 1, min=1, max=2)
    kinematic_error: float = option(
        "--kinematic-error SCALE",
        "Of nominal kinematics: 1 is 1° and 1 mm in the joints, 2° and 5 mm from camera to base.",
        0.0,
        min=0.0,
        max=20.0,
    )
    degrade: list[str] | None = option(
        "--degrade NAME=SEVERITY",
        "Degrade the images, 1 to 5: defocus, motion_blur, noise, low_light, specular, smoke, jpeg; may be repeated.",
    )
    perturb: list[str] | None = option(
        "--perturb NAME=STRENGTH",
        "Make something other than log and profile say, as in focal=1; may be repeated. Names: docs/simulation.md.",
    )
    world: Literal["ideal", "real"] = option(
        "--world NAME", "ideal (the default), or real: everything is off as on real robots.", "ideal"
    )
    jpeg: int | None = option("--jpeg QUALITY", "Store images as JPEG. Default: PNG.", min=1, max=100)
    renderer: str = option("--renderer", "The only renderer.", "tiny", hidden=True)
    jobs: int | None = options.JOBS
    output: Path | None = option("--output -o FILE.mcap", "Log to write. Default: SCENARIO-SEED.mcap.")
    force: bool = options.FORCE
    profile: str = options.PROFILE
    episodes: int | None = option(
        "--episodes N",
        "Record N seeds, from --seed on; -o is a folder, or a name with {seed} or {episode}.",
        min=1,
        max=100_000,
    )
    skip_existing: bool = option("--skip-existing", "With --episodes: leave those that are there.", False)

    def _run(self) -> ExitCode:
        from svmdist.perturbations import UNPERTURBED, World, draw_world
        from svmdist.profile import load_profile
        from svmdist.simulation import scene
        from svmdist.simulation.motion import Scenario
        from svmdist.workflows.record import Episodes, Recipe, record

        if self.renderer != "tiny":
            raise UsageError(f"--renderer {self.renderer}: images are drawn by tiny; leave the option out")
        if self.skip_existing and (self.episodes is None or self.force):
            raise UsageError("--skip-existing goes with --episodes, and without --force")
        path = self.output or Path("" if self.episodes else f"{self.scenario}-{self.seed}.mcap")
        if self.episodes is None:
            output.require_ending(path, ".mcap")
            output.require_output(path)
        together = [",".join(self.perturb)] if self.perturb else None
        (perturbations,) = options.parse_perturbations(together) or (UNPERTURBED,)
        scenario = Scenario(self.scenario, self.seed, self.duration, self.images_per_second)
        profile, world = load_profile(self.profile), World(self.world)
        spoilt, drawn = options.parse_degradations(self.degrade), draw_world(world, self.seed, perturbations)
        effects = scene.Options(
            self.stereo, self.tag, self.kinematic_error, spoilt, self.arms, drawn, world, self.noise
        )
        recipe = Recipe(scenario, profile, effects, self.jpeg)
        if self.episodes is not None:
            series = Episodes(recipe, perturbations, self.force, self.skip_existing)
            return _record_episodes(series, path, self.episodes, self.jobs)
        with output.progress_bar(f"{scenario.name}, seed {self.seed}", "frames") as advance:
            result = record(recipe, path, force=self.force, jobs=self.jobs, on_progress=advance)
        counts = result.frame_count, result.message_count
        LOG.info("%s: %d frames, %d messages, %.2f MB", path, *counts, result.size_bytes / 1e6)
        return ExitCode.CLEAN


def _record_episodes(episodes: Episodes, path: Path, count: int, jobs: int | None) -> ExitCode:
    from svmdist.workflows.record import episode_paths, record_episodes

    scenario = episodes.recipe.scenario
    with output.progress_bar(f"{scenario.name}, {count} seeds", "recordings") as advance:
        found = record_episodes(episodes, episode_paths(path, scenario.name, scenario.seed, count), jobs, advance)
    made = [one for one in found if not one.failure]
    were_there = sum(one.was_there for one in made)
    LOG.info(
        "%d of %d recordings%s: %d frames, %.2f MB",
        *(len(made), count, f", {were_there} of them were there" if were_there else ""),
        *(sum(one.frame_count for one in made), sum(one.size_bytes for one in made) / 1e6),
    )
    for one in found:
        if one.failure:
            LOG.error("not recorded: %s", output.with_name(one.failure, one.path))
    return ExitCode.CLEAN if len(made) == count else ExitCode.LOSS if made else ExitCode.UNUSABLE


class Import(options.Options):
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
    camera_file: Path | None = option("--calibration FILE", "Of ROS, OpenCV (YAML, XML) or Kalibr; may be of a pair.")
    right_calibration: Path | None = option("--right-calibration FILE", "The right camera's own.")
    calibrated_at: str | None = option("--calibrated-at SIZE", "If images were scaled since, as in 1280x720.")
    crop: str | None = option("--crop X,Y,WIDTH,HEIGHT", "This part of each view, in px of the whole.")
    camera: str | None = option("--camera FX,FY,CX,CY", "The camera in px, in place of a file.")
    right_camera: str | None = option("--right-camera FX,…", "The right one. Default: the left one.")
    distortion: str | None = option("--distortion K1,K2,…", "With --camera: K1,K2,P1,P2[,K3…].")
    distortion_model: str = option(
        "--distortion-model NAME", "plumb_bob (the default), rational_polynomial or fisheye.", "plumb_bob"
    )
    baseline_length: str | None = option("--baseline LENGTH", "Between the cameras of a rectified pair, as in 5.2mm.")
    unit: Literal["m", "cm", "mm"] = option(
        "--unit UNIT", "Of lengths in calibration and poses: m (the default), cm, mm.", "m"
    )
    rate: float | None = option("--rate HZ", "Images per second, if neither names nor video tell.", min=1e-3, max=1e4)
    start: str = option("--start SECONDS", "Time of the first image, with --rate or a video.", "0")
    times: Path | None = option("--times FILE", "Times of the images: CSV, or JSON beside a video of dVRK.")
    poses: list[str] | None = option("--poses [NAME=]FILE", "Tool poses in the base of NAME (PSM1); may be repeated.")
    joints: list[str] | None = option("--joints [NAME=]FILE", "Joint positions; may be repeated.")
    joint_names: str | None = option("--joint-names NAME,…", "Of columns of --joints without names.")
    every: int = options.EVERY
    jpeg: int | None = option("--jpeg QUALITY", "Store what has to be decoded as JPEG. Default: PNG.", min=1, max=100)
    force: bool = options.FORCE

    def _run(self) -> ExitCode:
        from svmdist.importing.calibration import CalibrationOptions
        from svmdist.importing.tables import parse_stamp_ns
        from svmdist.workflows.import_log import ImportOptions, import_log

        path = self.output or Path(f"{self.source.resolve().stem}.mcap")
        output.require_ending(path, ".mcap")
        output.require_output(path)
        if self.right_camera is not None and self.camera is None:
            raise UsageError("--right-camera goes with --camera")
        if self.joint_names is not None and not self.joints:
            raise UsageError("--joint-names goes with --joints")
        of_two = self.baseline_length, self.right_camera, self.right_calibration
        for name, given in zip(("--baseline", "--right-camera", "--right-calibration"), of_two, strict=True):
            if given is not None and not (self.right or self.right_pattern or self.side_by_side):
                raise UsageError(f"{name} is of two views: name the right one, or say --side-by-side")
        with restated(ValueError, UsageError, f"--start {self.start}: "):
            start_ns = parse_stamp_ns(self.start, "s")
        asked = ImportOptions(
            self.source,
            CalibrationOptions(
                (self.camera_file, self.right_calibration),
                (_intrinsics("--camera", self.camera), _intrinsics("--right-camera", self.right_camera)),
                _numbers("--distortion", self.distortion) if self.distortion else (),
                self.distortion_model,
                options.parse_length_m("--baseline", self.baseline_length) if self.baseline_length else None,
                options.LENGTH_UNITS_M[self.unit],
                _whole_px("--calibrated-at", self.calibrated_at, SIZE, "WIDTHxHEIGHT, as in 1280x720"),
            ),
            *(self.right, self.pattern, self.right_pattern, self.side_by_side),
            *(self.rate, start_ns, self.times, self.every),
            _whole_px("--crop", self.crop, CROP, "X,Y,WIDTH,HEIGHT, as in 40,0,640,480"),
            _tables("--poses", self.poses),
            _tables("--joints", self.joints),
            tuple(name.strip() for name in self.joint_names.split(",")) if self.joint_names else None,
            self.jpeg,
        )
        with output.progress_bar(f"import {self.source.name}", "images") as advance:
            result = import_log(asked, path, force=self.force, on_progress=advance)
        counted = [f"{count} {topic}" for topic, count in result.counts.items() if "camera_info" not in topic]
        LOG.info("%s: %s; %.2f MB", path, ", ".join(counted), result.size_bytes / 1e6)
        if result.has_baseline is False:
            LOG.info("no baseline is known: stereo needs --baseline, or a calibration of the pair")
        for loss in result.losses:
            LOG.error("loss: %s", loss)
        for warning in result.warnings:
            LOG.warning("warning: %s", warning)
        if self.jpeg is None and result.size_bytes > LARGE_BYTES:
            read = [file for one in (self.source, self.right) if one is not None for file in files_of(one)]
            read_bytes = sum(file.stat().st_size for file in read if isinstance(file, Path))
            if (times := result.size_bytes / max(read_bytes, 1)) > MANY_TIMES:
                LOG.info("stored as PNG, %.0f times as large as its source: --jpeg 92 makes it smaller", times)
        LOG.info("next: %s", output.next_command("profile", "new", path, "-o", f"{path.stem}.toml"))
        return ExitCode.LOSS if result.losses else ExitCode.CLEAN


def _numbers(name: str, text: str) -> tuple[float, ...]:
    numbers = tuple(map(options.parse_number, text.split(",")))
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
    found: dict[str, Path] = {}
    for text in given or []:
        named = re.fullmatch(r"([A-Za-z][A-Za-z0-9_]*)=(.*)", text, re.DOTALL)
        instrument, file = named.groups() if named else ("PSM1", text)
        if instrument in found:
            raise UsageError(f"{name}: two files for the instrument {instrument}; name the other: NAME=FILE")
        found[instrument] = Path(file)
    return found


class New(OneLogOptions, options.TopicOption):
    """Write a commented profile from a log.

    It has the log's topics, frames and instruments, a chain that fits its joints, an instrument's sizes, colours where
    they are distinct, and the tissue's surface where two views show it. Guesses are marked MEASURE, with deviations as
    wide.

    Examples:
      A commented profile, to be completed by hand:
        svmdist profile new log.mcap -o mine.toml
      With the sizes of a known instrument:
        svmdist profile new log.mcap --instrument large-needle-driver
      With a camera's topic that is none of the usual ones:
        svmdist profile new log.mcap --topic image=/left/image_raw
    """

    name: str | None = option("--name NAME", "Name of the profile. Default: that of the log.")
    instrument: str | None = option(
        "--instrument NAME",
        "Sizes of large-needle-driver, da-vinci-8mm, laparoscopic-5mm, raven, …: a wrong name lists all. Default: by"
        " the joints, else 5 to 10 mm.",
    )
    output: Path | None = options.OutputOptions.output
    force: bool = options.FORCE

    def _run(self) -> None:
        import tomllib

        from svmdist.profile import Profile
        from svmdist.recording.log import open_recording
        from svmdist.report.profile_template import instrument_sizes, profile_text
        from svmdist.report.tables import counted
        from svmdist.workflows.check import check_log, warning
        from svmdist.workflows.new_profile import draft_profile

        output.require_toml(self.output, [self.log.path], force=self.force)
        if self.instrument is not None:
            instrument_sizes(self.instrument)
        with output.progress_bar(f"looking at {self.log.name}"):
            draft = draft_profile(self.log.path, self.name or self.log.name, self.topics, self.instrument)
            text = profile_text(draft)
            profile = Profile.model_validate(tomllib.loads(text))
            found = check_log(open_recording(self.log.path, profile))
        output.write_lines([text], self.output)
        instruments = ", ".join(one.name for one in draft.instruments)
        plane = "the plane from both views" if draft.plane else "measure the plane of the tissue"
        mark = "a distal marker by its colour" if draft.mark else "no colour of its own"
        LOG.info("%s: instruments %s; %s; %s", draft.name, instruments, mark, plane)
        if profile.guesses:
            sizes = "; --instrument NAME has sizes" if self.instrument is None else ""
            LOG.info("%s: guessed: %s%s", draft.name, profile.guesses, sizes)
        if said := warning(found):
            LOG.warning("%s", said)
        else:
            count = sum(len(one.comparisons) for one in found.values())
            LOG.info("%s of the log with it: nothing contradicts", counted(count, "comparison"))
        if self.output is not None:
            with_it = output.next_command("estimate", self.log.path, "--profile", self.output)
            LOG.info("next: complete what is marked MEASURE, and %s", with_it)
