"""Episodes: the same scenario with one seed after the other, each recorded by one of several processes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from svmdist.errors import OutputError, RecordingError, SvmdistError, UsageError
from svmdist.perturbations.chosen import Perturbations, draw_world
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Options
from svmdist.workflows.parallel import WorkerDiedError, each_in_processes, usable_cores
from svmdist.workflows.record import Recorded, record, recorded_metadata

SEED, NUMBER = "{seed}", "{episode}"


@dataclass(frozen=True)
class Episodes:
    """What is recorded: a scenario, of which each episode has the next seed, and the world that is drawn by it."""

    scenario: Scenario
    profile: Profile
    options: Options
    perturbations: Perturbations
    noise: float = 0.0
    jpeg_quality: int | None = None
    force: bool = False
    skip_existing: bool = False


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
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Recorded]:
    """Record an episode to each path, with the scenario's seed and those after it; what came of them, in order.

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
    found: dict[int, Recorded] = {}
    try:
        with closing(_recorded(episodes, paths, usable_cores() if jobs is None else jobs)) as done:
            for number, episode in done:
                found[number] = replace(episode, path=paths[number])
                if on_progress is not None:
                    on_progress(len(found), len(paths))
    finally:
        for number, path in enumerate(paths):
            if number not in found or found[number].failure:  # its process was ended
                with suppress(OSError):
                    _part(path).unlink(missing_ok=True)
    return [found[number] for number in range(len(paths))]


def _recorded(episodes: Episodes, paths: Sequence[Path], jobs: int) -> Generator[tuple[int, Recorded]]:
    numbered, workers = list(enumerate(paths)), min(jobs, len(paths))
    if workers <= 1:
        for number, path in numbered:
            yield number, record_episode(episodes, jobs, (number, path))
        return
    died = Recorded(Path(), failure=str(WorkerDiedError()))
    yield from each_in_processes(partial(record_episode, episodes, 1), numbered, workers, died=died)


def record_episode(episodes: Episodes, jobs: int, numbered: tuple[int, Path]) -> Recorded:
    """Record one episode, or leave it where it is there already. Raises UsageError for what no episode can have."""
    number, path = numbered
    seed = episodes.scenario.seed + number
    scenario = replace(episodes.scenario, seed=seed)
    perturbations = draw_world(episodes.options.world, seed, episodes.perturbations)
    options = replace(episodes.options, perturbations=perturbations)
    try:
        if episodes.skip_existing and path.exists():
            return _there(episodes, scenario, options, path)
        return record(
            scenario,
            episodes.profile,
            path,
            noise=episodes.noise,
            options=options,
            # A file that is to be left is not there; what an interrupted recording left of it goes.
            force=episodes.force or episodes.skip_existing,
            jpeg_quality=episodes.jpeg_quality,
            jobs=jobs,
        )
    except SvmdistError as problem:
        if isinstance(problem, UsageError) and number == 0 and not path.exists():
            raise  # all others would meet it too
        return Recorded(path, failure=str(problem))


def _there(episodes: Episodes, scenario: Scenario, options: Options, path: Path) -> Recorded:
    """An episode that is there already, unless the file is another recording."""
    expected = recorded_metadata(scenario, episodes.profile, episodes.noise, options, episodes.jpeg_quality)
    try:
        recording = open_recording(path, episodes.profile)
        found = recording.metadata
    except RecordingError as problem:
        return Recorded(path, failure=f"{problem}; --force replaces it")
    other = sorted(key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key))
    if other:
        reason = f"{path}: is another recording: {', '.join(other)} differ; --force replaces it"
        return Recorded(path, failure=reason)
    message_count = sum(info.message_count or 0 for info in recording.topics())
    return Recorded(path, recording.image_count() or 0, message_count, recording.size_bytes(), was_there=True)


def _part(path: Path) -> Path:
    return path.with_name(path.name + ".part")
