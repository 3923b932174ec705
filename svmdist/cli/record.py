"""`svmdist record`: simulate a scenario and write its recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from svmdist.cli.options import FORCE, JOBS, PROFILE, Options, option, parse_degradations, parse_perturbations
from svmdist.cli.output import LOG, ExitCode, progress_bar, require_output, with_name
from svmdist.errors import UsageError

if TYPE_CHECKING:
    from svmdist.workflows.record import Episodes


class Record(Options):
    """Simulate the robot and write a recording.

    The recording holds images, joint states, the robot's nominal transforms, and ground truth.

    Examples:
      Eight seconds in which the tool touches the tissue:
        svmdist record --scenario contact
      Two cameras, a tag, and errors as real robots have them:
        svmdist record --stereo --tag --world real --seed 7 -o real-7.mcap
    """

    scenario: Literal["calibration", "sweep", "approach", "contact", "occlusion", "random"] = option(
        "--scenario NAME",
        "calibration, sweep (the default), approach, contact, occlusion or random.",
        "sweep",
    )
    seed: int = option("--seed N", "Of all that is random. Default: 1.", 1, min=0)
    duration: float = option("--duration SECONDS", "Default: 8.", 8.0, min=0.2, max=3600.0)
    images_per_second: float = option("--rate HZ", "Images per second. Default: 10.", 10.0, min=0.5, max=60.0)
    noise: float = option(
        "--noise LEVELS", "Sensor noise (standard deviation), in 8-bit levels.", 0.0, min=0.0, max=50.0
    )
    stereo: bool = option("--stereo", "Add the right camera.", False)
    tag: bool = option("--tag", "Mount the profile's AprilTag plate.", False)
    arms: int = option(
        "--arms N",
        "Instruments: 1, or 2 that cross in the image.",
        1,
        min=1,
        max=2,
    )
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
        "--world NAME",
        "ideal (the default), or real: everything is off as on real robots.",
        "ideal",
    )
    jpeg: int | None = option("--jpeg QUALITY", "Store images as JPEG. Default: PNG.", min=1, max=100)
    renderer: str = option("--renderer", "The only renderer.", "tiny", hidden=True)
    jobs: int | None = JOBS
    output: Path | None = option("--output -o FILE.mcap", "Log to write. Default: SCENARIO-SEED.mcap.")
    force: bool = FORCE
    profile: str = PROFILE
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
            require_output(path)
        together = [",".join(self.perturb)] if self.perturb else None
        (perturbations,) = parse_perturbations(together) or (UNPERTURBED,)
        scenario = Scenario(self.scenario, self.seed, self.duration, self.images_per_second)
        profile, world = load_profile(self.profile), World(self.world)
        options = scene.Options(
            self.stereo,
            self.tag,
            self.kinematic_error,
            parse_degradations(self.degrade),
            self.arms,
            draw_world(world, self.seed, perturbations),
            world,
        )
        recipe = Recipe(scenario, profile, options, self.noise, self.jpeg)
        if self.episodes is not None:
            series = Episodes(recipe, perturbations, self.force, self.skip_existing)
            return _record_episodes(series, path, self.episodes, self.jobs)
        with progress_bar(f"{scenario.name}, seed {self.seed}", "frames") as advance:
            result = record(recipe, path, force=self.force, jobs=self.jobs, on_progress=advance)
        counts = result.frame_count, result.message_count
        LOG.info("%s: %d frames, %d messages, %.2f MB", path, *counts, result.size_bytes / 1e6)
        return ExitCode.CLEAN


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
            LOG.error("not recorded: %s", with_name(one.failure, one.path))
    return ExitCode.CLEAN if len(made) == count else ExitCode.LOSS if made else ExitCode.UNUSABLE
