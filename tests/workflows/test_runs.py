"""Runs: the figures are those of the method's own results, by threads and by processes alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.recording.encode import encode_all
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import CameraSample, DistanceSample, ImageSample, Sample
from svmdist.vision.degradations import Degradation
from svmdist.workflows.compare import Run, measure_runs, pooled_figures
from svmdist.workflows.conditions import CLEAN, Condition
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import prepare
from tests.synthetic import START_NS, make_scene, samples, write_log

SETUPS = [prepare(method="centroid"), prepare(method="kinematic")]
CONDITIONS = [CLEAN, Condition(Degradation.NOISE, 2)]
FRAMES = 6
TOTAL = (2 * FRAMES - 2) * len(SETUPS) * len(CONDITIONS)
"""Images of both logs, by every method under every condition."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    """Two logs of different lengths."""
    folder = tmp_path_factory.mktemp("runs")
    paths = [write_log(folder / f"{count}.mcap", frame_count=count) for count in (FRAMES, FRAMES - 2)]
    return [open_recording(path, SETUPS[0].profile) for path in paths]


def figures(run: Run) -> tuple[object, ...]:
    """What a run says, without its time: whose it is, and every pair of estimate and truth."""
    pairs = [
        None
        if score is None
        else (score.pairs.estimate_m.tobytes(), score.pairs.truth_m.tobytes(), score.statistics.rmse)
        for score in (run.planar, run.spatial, run.clearance)
    ]
    place = (run.recording.name, str(run.condition), run.method, run.instrument)
    return (*place, run.frame_count, run.measured_count, *pairs)


@pytest.fixture(scope="module")
def one_thread(recordings: list[Recording]) -> list[Run]:
    return list(measure_runs(recordings, SETUPS, CONDITIONS, jobs=1))


def test_processes_and_threads_give_the_same(recordings: list[Recording], one_thread: list[Run]) -> None:
    """One thread and two processes: the same runs in the same order, bit for bit, of the recordings that were given.

    Progress goes from 1 to the total, which the logs' summaries tell: each image counts once for each lane.
    """
    told: list[tuple[int, int | None]] = []
    processes = list(
        measure_runs(recordings, SETUPS, CONDITIONS, jobs=2, on_progress=lambda *at: told.append(at))
    )
    assert [figures(run) for run in processes] == [figures(run) for run in one_thread]
    assert all(run.recording is one.recording for run, one in zip(processes, one_thread, strict=True))
    assert all(run.seconds > 0.0 for run in processes)
    assert told == [(number, TOTAL) for number in range(1, TOTAL + 1)]


def test_threads_give_the_same(recordings: list[Recording], one_thread: list[Run]) -> None:
    """One method on one log under one condition has nothing to share: two jobs are threads."""
    clean = list(measure_runs(recordings[:1], SETUPS[:1], jobs=2))
    assert [figures(run) for run in clean] == [figures(one_thread[0])]


@pytest.mark.parametrize("jobs", [2, 3, 8])
@pytest.mark.parametrize("conditions", [CONDITIONS[:1], CONDITIONS])
def test_methods_are_shared_too(recordings: list[Recording], conditions: list[Condition], jobs: int) -> None:
    """Few logs and conditions: processes take methods each, and the runs are those of one thread, in its order."""
    setups = [prepare(method=method) for method in ("fused", "centroid", "fiducial", "kinematic")]
    for logs in (recordings[:1], recordings):
        one = list(measure_runs(logs, setups, conditions, jobs=1))
        shared = list(measure_runs(logs, setups, conditions, jobs=jobs))
        assert [figures(run) for run in shared] == [figures(run) for run in one]


def test_losses_are_told_once_in_the_file_s_order(tmp_path: Path) -> None:
    """One process reads right images too, another does not; what both lost stands between what one alone lost."""
    path = tmp_path / "lossy.mcap"
    scene, broken = make_scene(), {("right", 1), ("left", 2), ("right", 3)}
    P = np.hstack([scene.camera.K, scene.camera.K @ [[-0.005], [0.0], [0.0]]])
    right_camera = replace(scene.camera, P=P, frame_id="camera_right")
    with RecordingWriter(path, {"scenario": "synthetic"}) as writer:
        writer.write("/ECM/right/camera_info", CameraSample(START_NS, right_camera))
        frame = -1
        for topic, sample in samples(scene, 5):
            if not isinstance(sample, ImageSample):
                writer.write(topic, sample)
                continue
            frame += 1
            right = replace(sample, frame_id="camera_right")
            for side, to, image in (("left", topic, sample), ("right", "/ECM/right/image", right)):
                ((_, encoded),) = encode_all([(to, image)])
                data = encoded.data.replace(b"IHDR", b"XXXX") if (side, frame) in broken else encoded.data
                writer.write(to, replace(encoded, data=data))
    setups = [prepare(method=method) for method in ("centroid", "fused")]
    told = []
    for jobs in (1, 2):
        recording = open_recording(path, setups[0].profile)
        list(measure_runs([recording], setups, jobs=jobs))
        told.append(recording.health.losses)
    assert told[1] == told[0]
    assert [loss.topic for loss in told[0]] == ["/ECM/right/image", "/ECM/left/image", "/ECM/right/image"]


def test_runs_come_by_recording_condition_and_method(
    recordings: list[Recording], one_thread: list[Run]
) -> None:
    expected = [
        (recording.name, condition, setup.method)
        for recording in recordings
        for condition in CONDITIONS
        for setup in SETUPS
    ]
    assert [(run.recording.name, run.condition, run.method) for run in one_thread] == expected
    assert [run.frame_count for run in one_thread] == [FRAMES] * 4 + [FRAMES - 2] * 4


def test_a_run_scores_what_the_method_gives(recordings: list[Recording]) -> None:
    """The RMSE of the estimates against the truth at their stamps, computed here once more."""
    recording, setup = recordings[0], SETUPS[0]
    (run,) = measure_runs([recording], [setup], jobs=1)
    results = [result for result in estimate(recording, setup, jobs=1) if result.measured]
    truth = recording.distance_track().at(np.array([result.stamp_ns for result in results]))
    errors_m = [
        result.distances.planar.value_m - true_m
        for result, true_m in zip(results, truth.planar_m, strict=True)
        if result.distances.planar is not None
    ]
    assert run.planar is not None
    assert run.planar.statistics.rmse == pytest.approx(np.sqrt(np.mean(np.square(errors_m))), rel=1e-12)
    assert run.measured_count == len(results)
    assert run.spatial is None
    assert run.clearance is None


def test_progress_counts_every_measurement(recordings: list[Recording]) -> None:
    """As with processes; here while the frames are measured."""
    told: list[tuple[int, int | None]] = []
    runs = measure_runs(recordings, SETUPS, CONDITIONS, jobs=1, on_progress=lambda *at: told.append(at))
    next(runs)
    assert told == [(number, TOTAL) for number in range(1, FRAMES * len(SETUPS) * len(CONDITIONS) + 1)]


def test_a_log_without_truth_is_told_before_the_work(tmp_path: Path, recordings: list[Recording]) -> None:
    """Even as the last of several."""

    def without_truth(_topic: str, sample: Sample) -> Sample | None:
        return None if isinstance(sample, DistanceSample) else sample

    bare = open_recording(
        write_log(tmp_path / "bare.mcap", frame_count=2, change=without_truth), SETUPS[0].profile
    )
    steps: list[int] = []
    with pytest.raises(RecordingError):
        list(measure_runs([*recordings, bare], SETUPS, on_progress=lambda number, _: steps.append(number)))
    assert not steps


def test_pooled_figures_count_every_frame_alike(recordings: list[Recording]) -> None:
    """Counts and times add up; the pooled mean square is the frames' mean, not the runs'."""
    runs = list(measure_runs(recordings, SETUPS[:1], jobs=1, clock=lambda: 0.0))
    assert all(run.seconds == 0.0 for run in runs)
    runs = [replace(run, seconds=seconds) for run, seconds in zip(runs, (0.6, 0.2), strict=True)]
    pooled = pooled_figures(runs)
    assert pooled.frame_count == sum(run.frame_count for run in runs)
    assert pooled.measured_count == sum(run.measured_count for run in runs)
    assert pooled.coverage == pooled.measured_count / pooled.frame_count
    assert pooled.ms_per_frame == pytest.approx(800.0 / pooled.frame_count)
    assert pooled.planar is not None
    squares = [run.measured_count * run.planar.statistics.rmse**2 for run in runs if run.planar is not None]
    assert pooled.planar.statistics.rmse == pytest.approx(
        np.sqrt(sum(squares) / pooled.measured_count), rel=1e-12
    )
    assert pooled_figures([]).ms_per_frame == 0.0
