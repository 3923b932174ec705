"""Episodes: the same scenario with one seed after the other, each recorded by one of several processes."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from svmdist.errors import OutputError, RecordingError, SvmdistError, UsageError
from svmdist.files import is_held
from svmdist.perturbations.chosen import Perturbations, draw_world
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.workflows.batch.pool import Task, measured_in_processes
from svmdist.workflows.batch.run import Progress, unheard
from svmdist.workflows.batch.task import LogFile, Stored, failed
from svmdist.workflows.parallel import usable_cores
from svmdist.workflows.record import record, recorded_metadata

SEED, NUMBER = "{seed}", "{episode}"


@dataclass(frozen=True)
class Episodes:
    """What is recorded: a scenario, of which each episode has the next seed, and the world that is drawn by it."""

    scenario: Scenario
    profile: Profile
    extras: Extras
    perturbations: Perturbations
    renderer: str = "tiny"
    noise: float = 0.0
    jpeg_quality: int | None = None
    force: bool = False
    skip_existing: bool = False


@dataclass(frozen=True)
class Recorded:
    """One episode: what was written, or that it was there already."""

    frame_count: int
    message_count: int
    size_bytes: int
    was_there: bool = False


@dataclass(frozen=True)
class EpisodeOutcome:
    """What came of an episode; `failure` says why there is no recording."""

    path: Path
    seed: int
    recorded: Recorded | None
    failure: str | None = None


def episode_paths(output: Path, scenario: str, first_seed: int, count: int) -> list[Path]:
    """The files of episodes: by a pattern with {seed} or {episode}, else SCENARIO-SEED.mcap in a folder.

    The folder is made. Raises UsageError for a name that would be the same for all, and OutputError.
    """
    seeds = range(first_seed, first_seed + count)
    text = str(output)
    if SEED in text or NUMBER in text:
        paths = [
            Path(text.replace(SEED, str(seed)).replace(NUMBER, f"{number:0{len(str(count))}d}"))
            for number, seed in enumerate(seeds, 1)
        ]
    elif output.suffix.lower() == ".mcap":
        raise UsageError(
            f"{output}: is one name for {count} episodes: give a folder, or a name with {SEED} or {NUMBER}"
        )
    else:
        paths = [output / f"{scenario}-{seed}.mcap" for seed in seeds]
    for folder in dict.fromkeys(path.parent for path in paths):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise OutputError(f"{folder}: cannot write: {problem.strerror or problem}") from None
    return paths


def record_episodes(
    episodes: Episodes,
    paths: Sequence[Path],
    jobs: int | None = None,
    on_progress: Progress = unheard,
) -> list[EpisodeOutcome]:
    """Record an episode to each path, with the scenario's seed and those after it; gives what came of them, in order.

    An episode that cannot be recorded does not stop the others. The files are the same for any number of jobs. Raises
    UsageError before the work where a file exists and may neither be replaced nor left.
    """
    if not episodes.force and not episodes.skip_existing:
        for path in paths:
            for there in (path, _part(path)):
                if there.exists():
                    raise UsageError(
                        f"{there} exists; --skip-existing leaves episodes that are whole, --force replaces all"
                    )
    tasks = [
        Task(number, LogFile(path, str(episodes.scenario.seed + number)), path)
        for number, path in enumerate(paths)
    ]
    found: dict[int, EpisodeOutcome] = {}
    on_progress(0, len(tasks))
    try:
        with closing(_recorded(episodes, tasks, usable_cores() if jobs is None else jobs)) as done:
            for task, stored in done:
                result = None if stored.failure else Recorded(**stored.result)
                outcome = EpisodeOutcome(paths[task.number], int(task.log.name), result, stored.failure)
                found[task.number] = outcome
                on_progress(len(found), len(tasks))
    finally:
        for task in tasks:
            ended = found.get(task.number)
            if ended is None or ended.failure:  # its process was ended: what it left is no recording
                _remove_part(paths[task.number])
    return [found[number] for number in range(len(tasks))]


def _recorded(episodes: Episodes, tasks: Sequence[Task], jobs: int) -> Generator[tuple[Task, Stored]]:
    workers = min(jobs, len(tasks))
    if workers <= 1:
        for task in tasks:
            yield task, record_episode(episodes, task, jobs)
        return
    work = partial(record_episode, episodes)
    yield from measured_in_processes(work, tasks, workers, max(1, jobs // workers), forks=True)


def record_episode(episodes: Episodes, task: Task, jobs: int) -> Stored:
    """Record one episode, or leave it where it is there already. Raises UsageError for what no episode can have."""
    seed = int(task.log.name)
    scenario = replace(episodes.scenario, seed=seed)
    world = episodes.extras.world
    extras = replace(episodes.extras, perturbations=draw_world(world, seed, episodes.perturbations))
    path = task.rows
    try:
        if episodes.skip_existing and path.exists():
            return _there(episodes, scenario, extras, path)
        done = record(
            scenario,
            episodes.profile,
            path,
            renderer=episodes.renderer,
            noise=episodes.noise,
            extras=extras,
            # A file that is to be left is not there; what an interrupted recording left of it goes.
            force=episodes.force or episodes.skip_existing,
            jpeg_quality=episodes.jpeg_quality,
            jobs=jobs,
        )
    except UsageError as problem:
        if task.number == 0 and not path.exists():
            raise  # all others would meet it too
        return failed(str(problem))
    except SvmdistError as problem:
        return failed(str(problem))
    return _stored(Recorded(done.frame_count, done.message_count, done.size_bytes))


def _there(episodes: Episodes, scenario: Scenario, extras: Extras, path: Path) -> Stored:
    """An episode that is there already, unless the file is another recording."""
    expected = recorded_metadata(
        scenario, episodes.profile, episodes.renderer, episodes.noise, extras, episodes.jpeg_quality
    )
    try:
        recording = open_recording(path, episodes.profile)
        found = recording.metadata
    except RecordingError as problem:
        return failed(f"{problem}; --force replaces it")
    other = sorted(key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key))
    if other:
        return failed(f"{path}: is another recording: {', '.join(other)} differ; --force replaces it")
    topics = recording.topics()
    return _stored(
        Recorded(
            recording.image_count() or 0,
            sum(info.message_count or 0 for info in topics),
            recording.size_bytes(),
            was_there=True,
        )
    )


def _stored(recorded: Recorded) -> Stored:
    return Stored(None, asdict(recorded), (), 0, {}, (), 0)


def _part(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def _remove_part(path: Path) -> None:
    with suppress(OSError):
        if _part(path).exists() and not is_held(_part(path)):
            _part(path).unlink()
