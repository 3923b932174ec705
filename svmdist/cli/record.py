"""`svmdist record`: simulate a scenario and write its recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import ExitCode, Verbosity, require_output, say
from svmdist.cli.degradations import parse_degradations
from svmdist.cli.options import ProfileOption
from svmdist.cli.perturbations import parse_perturb
from svmdist.cli.progress import progress_bar
from svmdist.errors import UsageError

if TYPE_CHECKING:
    from svmdist.workflows.episodes import Episodes


class ScenarioName(StrEnum):
    """`--scenario`."""

    CALIBRATION = "calibration"
    SWEEP = "sweep"
    APPROACH = "approach"
    CONTACT = "contact"
    OCCLUSION = "occlusion"
    RANDOM = "random"


class WorldName(StrEnum):
    """`--world`."""

    IDEAL = "ideal"
    REAL = "real"


def record_command(
    scenario: Annotated[
        ScenarioName, typer.Option("--scenario", help="Motion of the instrument.")
    ] = ScenarioName.SWEEP,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            metavar="N",
            min=0,
            help="Seed of everything random; the same seed gives the same content.",
        ),
    ] = 1,
    duration: Annotated[
        float,
        typer.Option("--duration", metavar="SECONDS", min=0.2, max=3600.0, help="Duration of the recording."),
    ] = 8.0,
    rate: Annotated[
        float, typer.Option("--rate", metavar="HZ", min=0.5, max=60.0, help="Images per second.")
    ] = 10.0,
    noise: Annotated[
        float,
        typer.Option(
            "--noise",
            metavar="LEVELS",
            min=0.0,
            max=50.0,
            help="Standard deviation of the sensor noise, in 8-bit levels.",
        ),
    ] = 0.0,
    stereo: Annotated[
        bool, typer.Option("--stereo", help="Add the right camera: /ECM/right/image and its camera_info.")
    ] = False,
    tag: Annotated[
        bool, typer.Option("--tag", help="Mount the profile's AprilTag plate on the instrument.")
    ] = False,
    arms: Annotated[
        int,
        typer.Option(
            "--arms",
            metavar="N",
            min=1,
            max=2,
            help="Number of instruments. 2 adds the profile's second one, which crosses the first one in the image.",
        ),
    ] = 1,
    kinematic_error: Annotated[
        float,
        typer.Option(
            "--kinematic-error",
            metavar="SCALE",
            min=0.0,
            max=20.0,
            help="Error of the robot's nominal kinematics, drawn by seed: 1 is 1° and 1 mm in the joints, "
            "2° and 5 mm from camera to base.",
        ),
    ] = 0.0,
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            "--degrade",
            metavar="NAME=SEVERITY",
            help="Degrade the images, severity 1 to 5: defocus, motion_blur, noise, low_light, specular, smoke, "
            "jpeg; may be repeated.",
            show_default=False,
        ),
    ] = None,
    perturb: Annotated[
        list[str] | None,
        typer.Option(
            "--perturb",
            metavar="NAME=STRENGTH",
            help="Make something other than log and profile say, as in focal=1 or backlash=0.5; may be repeated. "
            "Names and units: docs/simulation.md.",
            show_default=False,
        ),
    ] = None,
    world: Annotated[
        WorldName,
        typer.Option(
            "--world",
            help="ideal: log and profile are exact; real: everything is off as on real robots, drawn by seed.",
        ),
    ] = WorldName.IDEAL,
    jpeg: Annotated[
        int | None,
        typer.Option(
            "--jpeg",
            metavar="QUALITY",
            min=1,
            max=100,
            help="Store images as JPEG, as the recorders of endoscopes do. Default: PNG, without loss.",
            show_default=False,
        ),
    ] = None,
    renderer: Annotated[str, typer.Option("--renderer", hidden=True)] = "tiny",
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            metavar="N",
            min=1,
            help="Number of processes that render. The file is the same for any number. Default: all usable cores.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.mcap",
            help="Recording to write. Default: SCENARIO-SEED.mcap.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    profile: ProfileOption = "psm13",
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes",
            metavar="N",
            min=1,
            max=100_000,
            help="Record N seeds, from --seed on, in --jobs processes. --output is then a folder, or a name with"
            " {seed} or {episode}.",
            show_default=False,
        ),
    ] = None,
    skip_existing: Annotated[
        bool,
        typer.Option(
            "--skip-existing", help="With --episodes: leave those that are there, to go on with the others."
        ),
    ] = False,
) -> None:
    """Simulate the robot and write a recording.

    The recording holds images, joint states, the robot's nominal transforms, and ground truth.
    """
    from svmdist.perturbations.chosen import World, draw_world
    from svmdist.profile import load_profile
    from svmdist.simulation.scenarios import Scenario
    from svmdist.simulation.scene import Options
    from svmdist.workflows.record import record

    if renderer != "tiny":
        raise UsageError(f"--renderer {renderer}: images are drawn by tiny only; leave the option out")
    if skip_existing and (episodes is None or force):
        raise UsageError("--skip-existing goes with --episodes, and without --force")
    motion, described = Scenario(scenario.value, seed, duration, rate), load_profile(profile)
    given = parse_perturb("--perturb", perturb)
    options = Options(
        stereo,
        tag,
        kinematic_error,
        parse_degradations("--degrade", degrade),
        arms,
        draw_world(World(world.value), seed, given),
        World(world.value),
    )
    if episodes is not None:
        from svmdist.workflows.episodes import Episodes

        series = Episodes(motion, described, options, given, noise, jpeg, force, skip_existing)
        raise typer.Exit(_record_episodes(series, output or Path(), episodes, jobs))
    path = output or Path(f"{scenario.value}-{seed}.mcap")
    require_output(path)
    with progress_bar(f"{scenario.value}, seed {seed}", "frames") as advance:
        result = record(
            motion,
            described,
            path,
            noise=noise,
            options=options,
            force=force,
            jpeg_quality=jpeg,
            jobs=jobs,
            on_progress=advance,
        )
    size_mb = result.size_bytes / 1e6
    say(f"svmdist: {path}: {result.frame_count} frames, {result.message_count} messages, {size_mb:.2f} MB")


def _record_episodes(episodes: Episodes, output: Path, count: int, jobs: int | None) -> ExitCode:
    from svmdist.workflows.episodes import episode_paths, record_episodes

    scenario = episodes.scenario
    paths = episode_paths(output, scenario.name, scenario.seed, count)
    with progress_bar(f"{scenario.name}, {count} seeds", "recordings") as advance:
        found = record_episodes(episodes, paths, jobs, advance)
    made = [one for one in found if not one.failure]
    were_there = sum(one.was_there for one in made)
    left = f", {were_there} of them were there" if were_there else ""
    say(
        f"svmdist: {len(made)} of {count} recordings{left}: {sum(one.frame_count for one in made)} frames,"
        f" {sum(one.size_bytes for one in made) / 1e6:.2f} MB"
    )
    for one in found:
        if one.failure:
            reason = one.failure if str(one.path) in one.failure else f"{one.path}: {one.failure}"
            say(f"svmdist: not recorded: {reason}", Verbosity.QUIET)
    if not made:
        return ExitCode.UNUSABLE
    return ExitCode.CLEAN if len(made) == count else ExitCode.LOSS
