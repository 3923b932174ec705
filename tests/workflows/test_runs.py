"""Runs: the figures are those of the method's own results, by threads and by processes alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.writer import RecordingWriter, encode
from svmdist.samples import CameraSample, DistanceSample, ImageSample, Sample
from svmdist.vision.degradations import Degradation
from svmdist.workflows.compare import MethodScore, measure_runs, pooled_figures
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import CLEAN, Condition, prepare
from tests.synthetic import START_NS, make_scene, samples, write_log

SETUPS = [prepare(method=method) for method in ("fused", "centroid", "fiducial", "kinematic")]
CONDITIONS = [CLEAN, Condition(Degradation.NOISE, 2)]
FRAMES = 6


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = write_log(tmp_path_factory.mktemp("runs") / "a.mcap", frame_count=FRAMES)
    return open_recording(path, SETUPS[0].profile)


def figures(run: MethodScore) -> tuple[object, ...]:
    """What a run says, without its time: whose it is, and every pair of estimate and truth."""
    of = run.figures
    pairs = [
        score and (score.pairs.estimate_m.tobytes(), score.pairs.truth_m.tobytes(), score.statistics.rmse)
        for score in (of.planar, of.spatial, of.clearance)
    ]
    return (run.group, run.method, run.instrument, of.frame_count, of.measured_count, *pairs)


@pytest.mark.parametrize("jobs", [2, 3, 8])
@pytest.mark.parametrize("conditions", [CONDITIONS[:1], CONDITIONS])
def test_processes_and_threads_give_the_same(
    recording: Recording, conditions: list[Condition], jobs: int
) -> None:
    """In the order of conditions and methods, bit for bit; each image counts once for each of them."""
    alone = measure_runs(recording, SETUPS, conditions, jobs=1)
    counted: list[int] = []
    shared = measure_runs(recording, SETUPS, conditions, jobs=jobs, advance=lambda: counted.append(1))
    assert [figures(run) for run in shared] == [figures(run) for run in alone]
    assert [run.method for run in alone] == [setup.method for setup in SETUPS] * len(conditions)
    assert all(run.figures.seconds > 0.0 for run in shared)
    assert len(counted) == FRAMES * len(SETUPS) * len(conditions)


def test_losses_are_listed_once_in_the_file_s_order(tmp_path: Path) -> None:
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
                encoded = encode(image)
                data = encoded.data.replace(b"IHDR", b"XXXX") if (side, frame) in broken else encoded.data
                writer.write(to, replace(encoded, data=data))
    losses = []
    for jobs in (1, 2):
        recording = open_recording(path, SETUPS[0].profile)
        measure_runs(recording, SETUPS[:2], jobs=jobs)
        losses.append(recording.health.losses)
    assert losses[1] == losses[0]
    assert [loss.topic for loss in losses[0]] == ["/ECM/right/image", "/ECM/left/image", "/ECM/right/image"]


def test_a_run_scores_what_the_method_gives(recording: Recording) -> None:
    """The RMSE of the estimates against the truth at their stamps, computed here once more."""
    setup = SETUPS[1]
    (run,) = measure_runs(recording, [setup], jobs=1)
    rows = [row for row in estimate(recording, setup, jobs=1) if row.measured]
    truth = recording.distance_track().at(np.array([row.stamp_ns for row in rows]))
    errors = [
        row.distances.planar.value_m - true_m
        for row, true_m in zip(rows, truth.planar_m, strict=True)
        if row.distances.planar
    ]
    assert run.figures.planar is not None
    assert run.figures.planar.statistics.rmse == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    pooled = pooled_figures([run.figures, run.figures])
    assert pooled.frame_count == 2 * FRAMES
    assert pooled.ms_per_frame == pytest.approx(run.figures.ms_per_frame)


def test_a_log_without_truth_is_refused_before_the_work(tmp_path: Path) -> None:
    def no_truth(_topic: str, sample: Sample) -> Sample | None:
        return None if isinstance(sample, DistanceSample) else sample

    bare = open_recording(write_log(tmp_path / "bare.mcap", change=no_truth), SETUPS[0].profile)
    steps: list[int] = []
    with pytest.raises(RecordingError, match="ground_truth_distance"):
        measure_runs(bare, SETUPS, advance=lambda: steps.append(1))
    assert not steps
