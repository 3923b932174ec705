"""Record a scenario: the simulation's samples into a recording, with what they came from as metadata."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from svmdist.errors import UsageError
from svmdist.profile import Profile
from svmdist.recording.writer import RecordingWriter
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.simulate import simulate, topic_names

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
    on_progress: Callable[[int, int], None] | None = None,
) -> RecordResult:
    """Simulate a scenario and write it to `output`; `on_progress` hears of (images done, images in all).

    Images are PNG, which keeps them to the last bit, or JPEG of a quality from 1 to 100.

    Raises UsageError where the file exists and `force` is not set, OutputError where it cannot be written,
    SimulationError where PyBullet is missing or the profile cannot be simulated.
    """
    extras = extras or Extras()
    if jpeg_quality is not None and not 1 <= jpeg_quality <= 100:
        raise UsageError(f"the quality of JPEG is from 1 to 100, found {jpeg_quality}")
    metadata = _metadata(scenario, profile, renderer, noise) | extras.metadata()
    if jpeg_quality is not None:
        metadata["jpeg_quality"] = str(jpeg_quality)
    topics = topic_names(profile)
    frame_count = message_count = 0
    with RecordingWriter(output, metadata, force=force, jpeg_quality=jpeg_quality) as writer:
        for topic, sample in simulate(scenario, profile, renderer=renderer, noise=noise, extras=extras):
            writer.write(topic, sample)
            message_count += 1
            if topic == topics.image:
                frame_count += 1
                if on_progress is not None:
                    on_progress(frame_count, scenario.frame_count)
    return RecordResult(output, frame_count, message_count, output.stat().st_size)


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
