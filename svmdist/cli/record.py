"""`svmdist record`: simulate a scenario and write its recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from svmdist.cli.options import FORCE, Options, option, output_option, parse_degradations, parse_perturbations
from svmdist.cli.output import LOG, ExitCode, progress_bar, require_output
from svmdist.errors import UsageError

if TYPE_CHECKING:
    from svmdist.workflows.record import Episodes


class RecordOptions(Options):
    """What `record` takes."""

    scenario: Literal["calibration", "sweep", "approach", "contact", "occlusion", "random"] = option(
        "sweep", "--scenario", "Motion of the instrument."
    )
    seed: int = option(
        1, "--seed N", "Seed of everything random; the same seed gives the same content.", min=0
    )
    duration: float = option(8.0, "--duration SECONDS", "Duration of the recording.", min=0.2, max=3600.0)
    rate: float = option(10.0, "--rate HZ", "Images per second.", min=0.5, max=60.0)
    noise: float = option(
        0.0, "--noise LEVELS", "Standard deviation of the sensor noise, in 8-bit levels.", min=0.0, max=50.0
    )
    stereo: bool = option(False, "--stereo", "Add the right camera: /ECM/right/image and its camera_info.")
    tag: bool = option(False, "--tag", "Mount the profile's AprilTag plate on the instrument.")
    arms: int = option(
        1,
        "--arms N",
        "Number of instruments. 2 adds the profile's second one, which crosses the first one in the image.",
        min=1,
        max=2,
    )
    kinematic_error: float = option(
        0.0,
        "--kinematic-error SCALE",
        "Error of the robot's nominal kinematics, drawn by seed: 1 is 1° and 1 mm in the joints, "
        "2° and 5 mm from camera to base.",
        min=0.0,
        max=20.0,
    )
    degrade: list[str] | None = option(
        None,
        "--degrade NAME=SEVERITY",
        "Degrade the images, severity 1 to 5: defocus, motion_blur, noise, low_light, specular, smoke, "
        "jpeg; may be repeated.",
    )
    perturb: list[str] | None = option(
        None,
        "--perturb NAME=STRENGTH",
        "Make something other than log and profile say, as in focal=1 or backlash=0.5; may be repeated. "
        "Names and units: docs/simulation.md.",
    )
    world: Literal["ideal", "real"] = option(
        "ideal",
        "--world",
        "ideal: log and profile are exact; real: everything is off as on real robots, drawn by seed.",
    )
    jpeg: int | None = option(
        None,
        "--jpeg QUALITY",
        "Store images as JPEG, as the recorders of endoscopes do. Default: PNG, without loss.",
        min=1,
        max=100,
    )
    renderer: str = option("tiny", "--renderer", "The only renderer.", hidden=True)
    jobs: int | None = option(
        None,
        "--jobs -j N",
        "Number of processes that render. The file is the same for any number. Default: all usable cores.",
        min=1,
    )
    output: Path | None = output_option("FILE.mcap", "Recording to write. Default: SCENARIO-SEED.mcap.")
    force: bool = FORCE
    profile: str = option(
        "psm13", "--profile NAME|FILE", "Scene profile: the name of one that ships, or a TOML file."
    )
    episodes: int | None = option(
        None,
        "--episodes N",
        "Record N seeds, from --seed on, in --jobs processes. --output is then a folder, or a name with"
        " {seed} or {episode}.",
        min=1,
        max=100_000,
    )
    skip_existing: bool = option(
        False, "--skip-existing", "With --episodes: leave those that are there, to go on with the others."
    )


def record_command(given: RecordOptions) -> None:
    """Simulate the robot and write a recording.

    The recording holds images, joint states, the robot's nominal transforms, and ground truth.

    Examples:
      Eight seconds in which the tool touches the tissue:
        svmdist record --scenario contact
      Two cameras, a tag, and errors as real robots have them:
        svmdist record --stereo --tag --world real --seed 7 -o real-7.mcap
    """
    from svmdist.perturbations.chosen import UNPERTURBED, World, draw_world
    from svmdist.profile import load_profile
    from svmdist.simulation import scene
    from svmdist.simulation.motion import Scenario
    from svmdist.workflows.record import Episodes, Recipe, record

    if given.renderer != "tiny":
        raise UsageError(f"--renderer {given.renderer}: images are drawn by tiny only; leave the option out")
    if given.skip_existing and (given.episodes is None or given.force):
        raise UsageError("--skip-existing goes with --episodes, and without --force")
    path = given.output or Path("" if given.episodes else f"{given.scenario}-{given.seed}.mcap")
    if given.episodes is None:
        require_output(path)
    given_together = [",".join(given.perturb)] if given.perturb else []
    (perturbations,) = parse_perturbations("--perturb", given_together) or (UNPERTURBED,)
    scenario = Scenario(given.scenario, given.seed, given.duration, given.rate)
    profile, world = load_profile(given.profile), World(given.world)
    options = scene.Options(
        given.stereo,
        given.tag,
        given.kinematic_error,
        parse_degradations("--degrade", given.degrade),
        given.arms,
        draw_world(world, given.seed, perturbations),
        world,
    )
    recipe = Recipe(scenario, profile, options, given.noise, given.jpeg)
    if given.episodes is not None:
        series = Episodes(recipe, perturbations, given.force, given.skip_existing)
        raise typer.Exit(_record_episodes(series, path, given.episodes, given.jobs))
    with progress_bar(f"{scenario.name}, seed {given.seed}", "frames") as advance:
        result = record(recipe, path, force=given.force, jobs=given.jobs, on_progress=advance)
    counts = result.frame_count, result.message_count
    LOG.info("%s: %d frames, %d messages, %.2f MB", path, *counts, result.size_bytes / 1e6)


def _record_episodes(episodes: Episodes, output: Path, count: int, jobs: int | None) -> ExitCode:
    from svmdist.workflows.record import episode_paths, record_episodes

    scenario = episodes.recipe.scenario
    paths = episode_paths(output, scenario.name, scenario.seed, count)
    with progress_bar(f"{scenario.name}, {count} seeds", "recordings") as advance:
        found = record_episodes(episodes, paths, jobs, advance)
    made = [one for one in found if not one.failure]
    were_there = sum(one.was_there for one in made)
    LOG.info(
        "%d of %d recordings%s: %d frames, %.2f MB",
        *(len(made), count, f", {were_there} of them were there" if were_there else ""),
        *(sum(one.frame_count for one in made), sum(one.size_bytes for one in made) / 1e6),
    )
    for one in found:
        if one.failure:
            reason = one.failure if str(one.path) in one.failure else f"{one.path}: {one.failure}"
            LOG.error("not recorded: %s", reason)
    if not made:
        return ExitCode.UNUSABLE
    return ExitCode.CLEAN if len(made) == count else ExitCode.LOSS
