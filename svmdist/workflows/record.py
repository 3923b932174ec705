"""Record simulated logs: one, or many episodes of one scenario."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from svmdist.errors import RecordingError, SvmdistError, UsageError
from svmdist.files import make_folder
from svmdist.perturbations import Perturbations, draw_world
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.recording.writer import EncodedSample, RecordingWriter, encode
from svmdist.samples import Sample
from svmdist.simulation.bullet import require_pybullet
from svmdist.simulation.motion import Scenario
from svmdist.simulation.plan import Plan, make_plan
from svmdist.simulation.scene import PLAIN, Options
from svmdist.simulation.simulate import Sensors, Simulator
from svmdist.workflows import parallel
from svmdist.workflows.parallel import Progress, unwatched

VERSIONED_PACKAGES = ("svmdist", "pybullet", "numpy", "opencv-python-headless")
FRAMES_PER_WORKER = 12
"""What a worker's start costs, about a second, is what so many images take: below this, one worker less is faster."""

Task = tuple[list[range], list[np.random.Generator]]


@dataclass(frozen=True)
class Recorded:
    """A recording that was written or was there, with its (left) images, messages and size; or why there is none."""

    path: Path
    frame_count: int = 0
    message_count: int = 0
    size_bytes: int = 0
    was_there: bool = False
    failure: str | None = None


@dataclass(frozen=True)
class Recipe:
    """What is simulated, and how images are stored: as PNG, without loss, or as JPEG of a quality from 1 to 100."""

    scenario: Scenario
    profile: Profile
    options: Options = PLAIN
    jpeg_quality: int | None = None

    def metadata(self) -> dict[str, str]:
        """What a recording states that it came from."""
        scenario, quality = self.scenario, self.jpeg_quality
        return {
            "scenario": scenario.name,
            "seed": str(scenario.seed),
            "duration_s": f"{scenario.duration_s:g}",
            "rate_hz": f"{scenario.rate_hz:g}",
            "noise": f"{self.options.noise:g}",
            "renderer": "tiny",
            "profile": self.profile.name,
            **{f"version_{name}": _version(name) for name in VERSIONED_PACKAGES},
            **self.options.metadata(),
            **({} if quality is None else {"jpeg_quality": str(quality)}),
        }


def record(
    recipe: Recipe, output: Path, *, force: bool = False, jobs: int | None = None, on_progress: Progress = unwatched
) -> Recorded:
    """Simulate a scenario and write it to `output`; `on_progress` is called with (images done, images in all).

    At most `jobs` processes draw images, by default as many as there are usable cores; the file is the same for any
    number. Raises UsageError where the file exists and `force` is not set, OutputError, SimulationError, and
    WorkerDiedError, which leaves no file.
    """
    writer = RecordingWriter(output, recipe.metadata(), force=force, jpeg_quality=recipe.jpeg_quality)
    try:
        with writer:
            plan = make_plan(recipe.scenario, recipe.profile, recipe.options)
            image = plan.topics["image"]
            with closing(_samples(plan, jobs or parallel.usable_cores(), recipe.jpeg_quality)) as samples:
                for topic, sample in samples:
                    writer.write(topic, sample)
                    if topic == image:
                        on_progress(writer.counts[image], recipe.scenario.frame_count)
    except parallel.WorkerDiedError:
        writer.discard()
        raise
    return Recorded(output, writer.counts[image], writer.counts.total(), output.stat().st_size)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _samples(plan: Plan, jobs: int, jpeg_quality: int | None) -> Generator[tuple[str, Sample | EncodedSample]]:
    """Yield (topic, sample) of a plan in order, by `jobs` processes, which encode them, or here for few images."""
    require_pybullet()  # before there are workers, each of which would report it
    workers = min(jobs, len(plan.blocks) // FRAMES_PER_WORKER)
    with parallel.one_opencv_thread():  # the cores are taken
        if workers <= 1:
            with Simulator(plan) as simulator:
                for block in plan.blocks:
                    yield from simulator.samples(block, simulator.sensors.draw_noise())
            return
        with parallel.process_pools() as make:
            pool = make(workers, partial(_begin, plan, jpeg_quality))
            for encoded in parallel.in_order(_work, _tasks(plan), workers, pool):
                yield from encoded


def _tasks(plan: Plan) -> Iterator[Task]:
    """The blocks of each task, an even number of pictures (see `Renderer`), and the random streams before it."""
    sensors = Sensors(plan.scene.camera, plan.scene.seed, plan.options)
    size = 1 if plan.options.stereo else 2
    for begin in range(0, len(plan.blocks), size):
        blocks = plan.blocks[begin : begin + size]
        yield blocks, deepcopy(sensors.generators)
        for _ in blocks:
            sensors.draw_noise()


_recorded: tuple[Callable[[], Simulator], int | None]  # in a worker: physics worlds for all its tasks, quality of JPEG


def _begin(plan: Plan, jpeg_quality: int | None) -> None:
    global _recorded  # noqa: PLW0603  (a worker has nothing else that outlives a task)
    _recorded = cache(partial(Simulator, plan)), jpeg_quality


def _work(task: Task) -> list[tuple[str, EncodedSample]]:
    worlds, jpeg_quality = _recorded
    simulator = worlds()  # made by the first task: what it raises is raised by that
    blocks, simulator.sensors.generators = task
    each = (one for block in blocks for one in simulator.samples(block, simulator.sensors.draw_noise()))
    return [(topic, encode(sample, jpeg_quality)) for topic, sample in each]


@dataclass(frozen=True)
class Episodes:
    """What is recorded: a recipe, of which each episode has the next seed, and the world that is sampled by it."""

    recipe: Recipe
    perturbations: Perturbations
    force: bool = False
    skip_existing: bool = False


def episode_paths(output: Path, scenario: str, first_seed: int, count: int) -> list[Path]:
    """Files by a pattern with {seed} or {episode}, else in a folder, which is made; UsageError, OutputError."""
    pattern = str(output)
    if "{seed}" not in pattern and "{episode}" not in pattern:
        if output.suffix.lower() == ".mcap":
            several = f"{pattern}: is one name for {count} episodes"
            raise UsageError(f"{several}: give a folder, or a name with {{seed}} or {{episode}}")
        pattern = str(output / f"{scenario}-{{seed}}.mcap")
    paths = []
    for number in range(count):
        episode = f"{number + 1:0{len(str(count))}d}"
        paths.append(Path(pattern.replace("{seed}", str(first_seed + number)).replace("{episode}", episode)))
    for folder in dict.fromkeys(path.parent for path in paths):
        make_folder(folder, "write")
    return paths


def record_episodes(
    episodes: Episodes, paths: Sequence[Path], jobs: int | None = None, on_progress: Progress = unwatched
) -> list[Recorded]:
    """Record an episode to each path, with the scenario's seed and those after it: what came of each, in order."""
    parts = [path.with_name(f"{path.name}.part") for path in paths]
    there = next((path for path in (*paths, *parts) if path.exists()), None)
    if there and not episodes.force and not episodes.skip_existing:
        raise UsageError(f"{there} exists; --skip-existing leaves episodes that are whole, --force replaces all")
    found: dict[int, Recorded] = {}
    jobs = parallel.usable_cores() if jobs is None else jobs
    workers = min(jobs, len(paths))
    work = partial(record_episode, episodes, jobs if workers == 1 else 1)
    died = Recorded(Path(), failure=str(parallel.WorkerDiedError()))
    try:
        with closing(parallel.each_in_processes(work, list(enumerate(paths)), workers, died=died)) as recorded:
            for number, episode in recorded:
                found[number] = replace(episode, path=paths[number])
                on_progress(len(found), len(paths))
    finally:
        for number, part in enumerate(parts):
            if number not in found or found[number].failure:  # its process was ended
                with suppress(OSError):
                    part.unlink(missing_ok=True)
    return [found[number] for number in range(len(paths))]


def record_episode(episodes: Episodes, jobs: int, numbered: tuple[int, Path]) -> Recorded:
    """Record one episode, or leave it where it is there already. Raises UsageError for what no episode can have."""
    number, path = numbered
    scenario, options = episodes.recipe.scenario, episodes.recipe.options
    scenario = replace(scenario, seed=scenario.seed + number)
    world = draw_world(options.world, scenario.seed, episodes.perturbations)
    recipe = replace(episodes.recipe, scenario=scenario, options=replace(options, perturbations=world))
    try:
        if episodes.skip_existing and path.exists():
            return _there(recipe, path)
        # A file that is to be left is not there; what an interrupted recording left of it goes.
        return record(recipe, path, force=episodes.force or episodes.skip_existing, jobs=jobs)
    except SvmdistError as problem:
        if isinstance(problem, UsageError) and number == 0 and not path.exists():
            raise  # all others would meet it too
        return Recorded(path, failure=str(problem))


def _there(recipe: Recipe, path: Path) -> Recorded:
    """An episode that is there already, unless the file is another recording."""
    try:
        recording = open_recording(path, recipe.profile)
    except RecordingError as problem:
        return Recorded(path, failure=f"{problem}; --force replaces it")
    expected, found = recipe.metadata(), recording.metadata
    if other := sorted({key for key, _ in expected.items() ^ found.items()}):
        return Recorded(path, failure=f"{path}: is another recording: {', '.join(other)} differ; --force replaces it")
    message_count = sum(info.message_count or 0 for info in recording.topics())
    return Recorded(path, recording.image_count() or 0, message_count, recording.size_bytes(), was_there=True)
