"""Record a scenario: the simulation's samples into a recording, with what they came from as metadata."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from svmdist.errors import UsageError
from svmdist.profile import Profile
from svmdist.recording.writer import RecordingWriter
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.plan import make_plan
from svmdist.workflows.parallel import usable_cores
from svmdist.workflows.record_workers import WorkerDiedError, encoded_samples

VERSIONED_PACKAGES = ("svmdist", "pybullet", "numpy", "opencv-python-headless")


@dataclass(frozen=True)
class RecordResult:
    """What was written: the numbers of (left) images and messages, the size in bytes, and where."""

    path: Path
    frame_count: int
    message_count: int
    size_bytes: int


def record(
    scenario: Scenario,
    profile: Profile,
    output: Path,
    *,
    renderer: str = "tiny",
    noise: float = 0.0,
    extras: Extras | None = None,
    force: bool = False,
    jpeg_quality: int | None = None,
    jobs: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> RecordResult:
    """Simulate a scenario and write it to `output`; `on_progress` hears of (images done, images in all).

    Images are PNG, which keeps them to the last bit, or JPEG of a quality from 1 to 100. `jobs` is the largest number
    of processes that draw images; None stands for that of usable cores. The file is the same for any number.

    Raises UsageError where the file exists and `force` is not set, OutputError where it cannot be written,
    SimulationError where PyBullet is missing, the profile cannot be simulated, or a process is killed, which leaves
    no file.
    """
    extras = extras or Extras()
    if jpeg_quality is not None and not 1 <= jpeg_quality <= 100:
        raise UsageError(f"the quality of JPEG is from 1 to 100, found {jpeg_quality}")
    if jobs is not None and jobs < 1:
        raise UsageError(f"the number of jobs is from 1, found {jobs}")
    metadata = recorded_metadata(scenario, profile, renderer, noise, extras, jpeg_quality)
    frame_count = message_count = 0
    writer = RecordingWriter(output, metadata, force=force, jpeg_quality=jpeg_quality)
    try:
        with writer:
            plan = make_plan(scenario, profile, renderer=renderer, noise=noise, extras=extras)
            with closing(encoded_samples(plan, jobs or usable_cores(), jpeg_quality)) as samples:
                for topic, sample in samples:
                    writer.write(topic, sample)
                    message_count += 1
                    if topic == plan.topics.image:
                        frame_count += 1
                        if on_progress is not None:
                            on_progress(frame_count, scenario.frame_count)
    except WorkerDiedError:
        writer.part_path.unlink(missing_ok=True)
        raise
    return RecordResult(output, frame_count, message_count, output.stat().st_size)


def recorded_metadata(
    scenario: Scenario,
    profile: Profile,
    renderer: str,
    noise: float,
    extras: Extras,
    jpeg_quality: int | None = None,
) -> dict[str, str]:
    """What a recording says that it came from."""
    metadata = _metadata(scenario, profile, renderer, noise) | extras.metadata()
    return metadata if jpeg_quality is None else metadata | {"jpeg_quality": str(jpeg_quality)}


def _metadata(scenario: Scenario, profile: Profile, renderer: str, noise: float) -> dict[str, str]:
    return {
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "duration_s": f"{scenario.duration_s:g}",
        "rate_hz": f"{scenario.rate_hz:g}",
        "noise": f"{noise:g}",
        "renderer": renderer,
        "profile": profile.name,
        **{f"version_{name}": _version(name) for name in VERSIONED_PACKAGES},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
