"""Record a scenario: the simulation's samples into a recording, with what they came from as metadata.

Several processes, each with physics worlds of its own, draw, expose and encode a few blocks of the plan at a time. The
samples come in order, and are the same for any number. The noise of all images is one random stream: this process
draws it too, to tell each task where the stream stands.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from svmdist.profile import Profile
from svmdist.recording.writer import EncodedSample, RecordingWriter, encode
from svmdist.simulation.bullet import require_pybullet
from svmdist.simulation.plan import Block, Plan, make_plan
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Options
from svmdist.simulation.simulate import NoiseStates, Sensors, Simulator
from svmdist.workflows.parallel import (
    WorkerDiedError,
    in_order,
    one_opencv_thread,
    process_pool,
    usable_cores,
)

VERSIONED_PACKAGES = ("svmdist", "pybullet", "numpy", "opencv-python-headless")
FRAMES_PER_WORKER = 12
"""What a worker's start costs, about a second, is what so many images take: below this, one worker less is faster."""

Task = tuple[list[Block], NoiseStates]


@dataclass(frozen=True)
class Recorded:
    """A recording that was written, or was there already: the numbers of (left) images and messages, and the size.

    `failure` says why there is no recording.
    """

    path: Path
    frame_count: int = 0
    message_count: int = 0
    size_bytes: int = 0
    was_there: bool = False
    failure: str | None = None


def record(
    scenario: Scenario,
    profile: Profile,
    output: Path,
    *,
    noise: float = 0.0,
    options: Options | None = None,
    force: bool = False,
    jpeg_quality: int | None = None,
    jobs: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Recorded:
    """Simulate a scenario and write it to `output`; `on_progress` is called with (images done, images in all).

    Images are PNG, without loss, or JPEG of a quality from 1 to 100. At most `jobs` processes draw images, by default
    as many as there are usable cores; the file is the same for any number. Raises UsageError where the file exists and
    `force` is not set, OutputError, SimulationError, and WorkerDiedError, which leaves no file.
    """
    options = options or Options()
    metadata = recorded_metadata(scenario, profile, noise, options, jpeg_quality)
    frame_count = message_count = 0
    writer = RecordingWriter(output, metadata, force=force, jpeg_quality=jpeg_quality)
    try:
        with writer:
            plan = make_plan(scenario, profile, noise=noise, options=options)
            with closing(encoded_samples(plan, jobs or usable_cores(), jpeg_quality)) as samples:
                for topic, sample in samples:
                    writer.write(topic, sample)
                    message_count += 1
                    if topic == plan.topics["image"]:
                        frame_count += 1
                        if on_progress is not None:
                            on_progress(frame_count, scenario.frame_count)
    except WorkerDiedError:
        writer.part_path.unlink(missing_ok=True)
        raise
    return Recorded(output, frame_count, message_count, output.stat().st_size)


def recorded_metadata(
    scenario: Scenario, profile: Profile, noise: float, options: Options, jpeg_quality: int | None = None
) -> dict[str, str]:
    """What a recording states that it came from."""
    return {
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "duration_s": f"{scenario.duration_s:g}",
        "rate_hz": f"{scenario.rate_hz:g}",
        "noise": f"{noise:g}",
        "renderer": "tiny",
        "profile": profile.name,
        **{f"version_{name}": _version(name) for name in VERSIONED_PACKAGES},
        **options.metadata(),
        **({} if jpeg_quality is None else {"jpeg_quality": str(jpeg_quality)}),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def encoded_samples(
    plan: Plan, jobs: int, jpeg_quality: int | None = None
) -> Generator[tuple[str, EncodedSample]]:
    """Yield (topic, sample) of a plan in the order of time, made by `jobs` processes or fewer.

    Recordings of few images are made in this process, which is faster then. Raises WorkerDiedError where a process is
    killed, and what a worker raised. The workers end with the iterator.
    """
    require_pybullet()  # before there are workers, each of which would report it
    workers = min(jobs, len(plan.blocks) // FRAMES_PER_WORKER)
    with one_opencv_thread():  # the cores are taken
        if workers <= 1:
            with Simulator(plan) as simulator:
                for block in plan.blocks:
                    for topic, sample in simulator.samples(block, simulator.sensors.draw_noise()):
                        yield topic, encode(sample, jpeg_quality)
            return
        with process_pool(workers, _begin, (plan, jpeg_quality)) as pool:
            for encoded in in_order(_work, _tasks(plan), workers, pool):
                yield from encoded


def _tasks(plan: Plan) -> Iterator[Task]:
    """The blocks of each task, and the state of the noise before it.

    A task has an even number of pictures, which spares the renderer a turn (see `DrawnWorld`).
    """
    sensors = Sensors(plan.scene.camera, plan.scene.seed, plan.noise, plan.options)
    all_blocks = plan.blocks
    size = 1 if plan.options.stereo else 2
    for begin in range(0, len(all_blocks), size):
        blocks = all_blocks[begin : begin + size]
        yield blocks, sensors.noise_states
        for _ in blocks:
            sensors.draw_noise()


_plan: Plan | None = None
_jpeg_quality: int | None = None
"""In a worker: what it records."""


def _begin(plan: Plan, jpeg_quality: int | None) -> None:
    global _plan, _jpeg_quality
    _plan, _jpeg_quality = plan, jpeg_quality


@cache
def _worlds() -> Simulator:
    """The physics worlds of this worker, for all its tasks."""
    assert _plan is not None  # the worker has begun
    return Simulator(_plan)


def _work(task: Task) -> list[tuple[str, EncodedSample]]:
    simulator = _worlds()
    blocks, simulator.sensors.noise_states = task
    encoded: list[tuple[str, EncodedSample]] = []
    for block in blocks:
        for topic, sample in simulator.samples(block, simulator.sensors.draw_noise()):
            encoded.append((topic, encode(sample, _jpeg_quality)))
    return encoded
