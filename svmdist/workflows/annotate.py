"""Annotate: a copy of a recording with what a method found and measured in it, for viewers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from svmdist.drawing import EstimateValues, FrameDrawing
from svmdist.estimation.alarms import AlarmRules, AlarmState, AlarmWatch
from svmdist.recording.encode import EncodedSample
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.summary import copied_messages
from svmdist.recording.topics import Role
from svmdist.recording.viewer_messages import (
    distance_estimate,
    image_annotations,
    log_line,
    scene_update,
    tool_transforms,
)
from svmdist.recording.writer import RecordingWriter
from svmdist.results import Distance, FrameResult
from svmdist.samples import Sample
from svmdist.workflows.frame_drawing import frame_drawing, interval_m
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import Setup

ANNOTATIONS = "annotations"
"""Below the image's topic: viewers that go by the names of topics lay it over the image."""
SCENE_TOPIC, TF_TOPIC, LOG_TOPIC = "/svmdist/scene", "/svmdist/tf", "/svmdist/log"


@dataclass(frozen=True)
class DrawnFrame:
    """One image of a log: what a method gave, the alarms by instrument, and the drawing."""

    number: int
    replayed: Replayed
    alarms: Mapping[str, AlarmState]
    drawing: FrameDrawing


def drawn_frames(
    recording: Recording,
    setup: Setup,
    rules: AlarmRules | None = None,
    wanted: Sequence[str] | None = None,
    jobs: int | None = None,
    numbers: Collection[int] | None = None,
    on_image: Callable[[], None] | None = None,
) -> Iterator[DrawnFrame]:
    """Replay a recording and draw every image, or those of some numbers; with `rules`, alarms are watched.

    What comes after the last of these numbers is not looked at. `on_image` hears of every image that is.
    """
    last = max(numbers, default=-1) if numbers is not None else None
    watches = {name: AlarmWatch(rules) for name in recording.instruments} if rules else {}
    for (replayed,) in replay(recording, [setup], wanted=wanted, jobs=jobs):
        number = replayed.results[0].number
        alarms = {
            result.instrument: watches[result.instrument].watch(result)
            for result in replayed.results
            if result.instrument in watches
        }
        if on_image is not None:
            on_image()
        if numbers is None or number in numbers:
            yield DrawnFrame(number, replayed, alarms, frame_drawing(replayed, setup, alarms))
        if last is not None and number >= last:
            return


def distance_topic(instrument: str) -> str:
    """The topic of an instrument's estimates."""
    return f"/svmdist/{instrument}/distance"


def write_annotated(
    recording: Recording, frames: Iterable[DrawnFrame], setup: Setup, output: Path, *, force: bool = False
) -> int:
    """Copy a recording to `output` with what was drawn of each image; gives how many images there were.

    What is copied is said in `copied_messages`. The file is written in the order of the log, each image followed by
    its annotations, and holds a few frames at a time. Raises UsageError where the file exists and `force` is not set.
    """
    metadata = {**recording.metadata, "annotated_by": f"svmdist estimate --method {setup.method}"}
    copies = _Copies(recording)
    count = 0
    with RecordingWriter(output, metadata, force=force) as writer:
        for frame in frames:
            for topic, sample in copies.until(frame.drawing.stamp_ns):
                writer.write(topic, sample)
            for topic, message in _annotations(recording, frame, setup, is_first=count == 0):
                writer.write(topic, message)
            count += 1
        for topic, sample in copies.rest():
            writer.write(topic, sample)
    return count


class _Copies:
    """The copied messages of a recording, up to a stamp at a time. They are read in a pass of their own."""

    def __init__(self, recording: Recording) -> None:
        origin = recording.origin
        if origin is None:
            raise TypeError("only a recording as it was opened can be copied")
        path, profile, limits, topics = origin
        # Opened anew, so that what is lost is counted once.
        self._messages = copied_messages(open_recording(path, profile, limits=limits, topics=topics))
        self._ahead = next(self._messages, None)

    def until(self, stamp_ns: int) -> Iterator[tuple[str, Sample | EncodedSample]]:
        while self._ahead is not None and self._ahead[1].stamp_ns <= stamp_ns:
            yield self._ahead
            self._ahead = next(self._messages, None)

    def rest(self) -> Iterator[tuple[str, Sample | EncodedSample]]:
        while self._ahead is not None:
            yield self._ahead
            self._ahead = next(self._messages, None)


def _annotations(
    recording: Recording, frame: DrawnFrame, setup: Setup, *, is_first: bool
) -> Iterator[tuple[str, EncodedSample]]:
    drawing, stamp_ns = frame.drawing, frame.drawing.stamp_ns
    frame_id = recording.logged_camera.frame_id
    if is_first:
        text = f"svmdist {version('svmdist')}, method {setup.method}, profile {setup.profile.name}"
        yield LOG_TOPIC, log_line(text, stamp_ns, is_warning=False)
    yield f"{recording.topic_of(Role.IMAGE)}/{ANNOTATIONS}", image_annotations(drawing)
    results = frame.replayed.results
    for result in results:
        values = estimate_values(result, setup.method, frame.alarms.get(result.instrument))
        yield distance_topic(result.instrument), distance_estimate(values, stamp_ns)
    poses = [
        (f"{result.instrument}_tool_estimate", result.tool.pose.T_camera_tool)
        for result in results
        if result.measured and result.tool is not None
    ]
    if poses:
        yield TF_TOPIC, tool_transforms(poses, frame_id, stamp_ns)
    names = [result.instrument for result in results]
    yield SCENE_TOPIC, scene_update(drawing.scene, names, frame_id, stamp_ns)
    for line in drawing.lines:
        if not line.measured or line.alarm:
            yield LOG_TOPIC, log_line(line.text, stamp_ns, is_warning=True)


def estimate_values(result: FrameResult, method: str, alarm: AlarmState | None = None) -> EstimateValues:
    """A result as the numbers of `svmdist.DistanceEstimate`."""
    alarm = alarm or AlarmState()
    distances, numbers = result.distances, dict[str, float | None]()
    named: tuple[tuple[str, Distance | None], ...] = (
        ("planar", distances.planar),
        ("spatial", distances.spatial),
        ("clearance", distances.clearance),
        ("to_instrument", distances.to_instrument),
    )
    for name, distance in named:
        numbers[f"{name}_m"] = distance.value_m if distance else None
        numbers[f"{name}_std_m"] = distance.std_m if distance else None
    bounds_m = interval_m(distances.clearance) if distances.clearance else None
    numbers["clearance_low_m"], numbers["clearance_high_m"] = bounds_m or (None, None)
    numbers["closing_speed_m_s"] = alarm.closing_speed_m_s
    numbers["time_to_contact_s"] = alarm.time_to_contact_s
    numbers["consistency"] = result.consistency
    return EstimateValues(result.instrument, method, str(result.status), result.detail, numbers, alarm.alarm)
