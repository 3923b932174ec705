"""Comparing methods: figures are those of validating each alone, by threads and processes alike; groups by metadata."""

from collections.abc import Container, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest

from svmdist.errors import RecordingError
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.source import LossKind
from svmdist.recording.writer import EncodedSample, encode
from svmdist.report.scores import compare_results
from svmdist.report.tables import keys_of, render
from svmdist.samples import CameraSample, ImageSample, Sample
from svmdist.simulation.scene import Options
from svmdist.vision.degradations import Degradation
from svmdist.workflows.compare import Group, MethodScore, compare, group_of, measure_runs
from svmdist.workflows.request import CLEAN, Condition, Request, prepare
from svmdist.workflows.scoring.references import Reference, TruthRules
from svmdist.workflows.validate import validate
from tests.synthetic import START_NS, make_scene, right_of, samples, without, write_log, write_samples

PLAIN = Options()


def log(path: Path, scenario: str, frame_count: int = 4, extras: Options = PLAIN, lost: Container[int] = ()) -> Path:
    """A drawn log with the metadata that `record` writes for these extras; lost frames are black."""
    frames = count()

    def blacken(_: str, sample: Sample) -> Sample:
        is_lost = isinstance(sample, ImageSample) and next(frames) in lost
        return replace(sample, image_bgr=0 * sample.image_bgr) if is_lost else sample

    metadata = {"scenario": scenario} | extras.metadata()
    return write_log(path, frame_count=frame_count, change=blacken, metadata=metadata)


def test_figures_are_those_of_validate(tmp_path, synthetic_calibration):
    """Per group and overall, R² and RMSE equal what `validate` gives for the method alone, lost frames or none."""
    setups = [prepare(method=method, calibration=synthetic_calibration) for method in ("overlay", "centroid")]
    paths = [
        log(tmp_path / "whole.mcap", "sweep", 14),
        log(tmp_path / "part.mcap", "occlusion", 10, lost=range(3, 7)),
    ]
    recordings = [open_recording(path, setups[0].profile) for path in paths]
    found = compare(recordings, setups, jobs=1)
    scores = {(str(s.group), s.method): s.figures for s in found}
    assert set(scores) == {(g, m) for g in ("sweep", "occlusion", "all") for m in ("overlay", "centroid")}
    rules = TruthRules(references=(Reference.GROUND_TRUTH,))
    for setup in setups:
        validation = validate(recordings, Request(setup, rules=rules))
        for score in (*validation.scores, *validation.overall):
            group = {"whole": "sweep", "part": "occlusion", "overall": "all"}[score.recording]
            compared = scores[group, setup.method]
            assert compared.coverage == score.coverage
            planar, expected = compared.planar.statistics, score.statistics
            assert planar.rmse == pytest.approx(expected.rmse, rel=1e-12)
            assert planar.r_squared == pytest.approx(expected.r_squared, rel=1e-12)
            assert compared.clearance is None  # of a planar method
            assert compared.ms_per_frame > 0.0


def test_groups_are_scenarios_and_recorded_degradations(tmp_path):
    """What `record --degrade` wrote into a log is what it is compared as; each degradation also over scenarios."""
    smoked = Options(degradations=(("smoke", 3),))
    setup = prepare(method="kinematic")
    recordings = [
        open_recording(log(tmp_path / f"{index}.mcap", scenario, extras=extras), setup.profile)
        for index, (scenario, extras) in enumerate(
            [("sweep", Options()), ("sweep", smoked), ("contact", smoked), ("contact", smoked)]
        )
    ]
    assert group_of(recordings[1]) == Group("sweep", "smoke=3")
    scores = compare(recordings, [setup])
    counts = [(str(score.group), score.figures.frame_count) for score in scores]
    groups = ["sweep", "sweep smoke=3", "contact smoke=3", "all clean", "all smoke=3", "all"]
    assert counts == list(zip(groups, [4, 4, 8, 4, 12, 16], strict=True))
    results = compare_results(scores)
    rows = list(results.rows)
    assert all(set(row) == set(keys_of(results.columns)) for row in rows)
    assert [(row["scenario"], row["degradation"]) for row in rows[:2]] == [
        ("sweep", ""),
        ("sweep", "smoke=3"),
    ]
    shown = "".join(render(table) for table in results.tables)
    assert "contact smoke=3: 1 methods on 8 frames" not in shown
    assert "contact smoke=3: 1 method on 8 frames" in shown
    assert max(map(len, shown.splitlines())) <= 100


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
        score and (score.estimate_m.tobytes(), score.truth_m.tobytes(), score.statistics.rmse)
        for score in (of.planar, of.spatial, of.clearance)
    ]
    return (run.group, run.method, run.instrument, of.frame_count, of.measured_count, *pairs)


@pytest.mark.parametrize("jobs", [2, 3, 8])
@pytest.mark.parametrize("conditions", [CONDITIONS[:1], CONDITIONS])
def test_processes_and_threads_give_the_same(recording, conditions, jobs):
    """In the order of conditions and methods, bit for bit; each image counts once for each pass over the log."""
    alone = measure_runs(recording, SETUPS, conditions, jobs=1)
    counted: list[tuple[int, int | None]] = []
    watched = replace(recording, on_progress=lambda *how_far: counted.append(how_far))
    shared = measure_runs(watched, SETUPS, conditions, jobs=jobs)
    assert [figures(run) for run in shared] == [figures(run) for run in alone]
    assert [run.method for run in alone] == [setup.method for setup in SETUPS] * len(conditions)
    assert all(run.figures.seconds > 0.0 for run in shared)
    total, left = len(counted), len(counted) % FRAMES
    assert total >= 2 * FRAMES > left == 0
    assert counted == [(done, total) for done in range(1, total + 1)]


def test_losses_are_listed_once_in_the_file_s_order(tmp_path):
    """One process reads right images too, another does not; what both lost stands between what one alone lost."""
    scene, frames = make_scene(), count()
    broken = {("right", 1), ("left", 2), ("right", 3)}

    def lossy() -> Iterator[tuple[str, Sample | EncodedSample]]:
        yield "/ECM/right/camera_info", CameraSample(START_NS, right_of(scene.camera))
        for topic, sample in samples(scene, 5):
            if not isinstance(sample, ImageSample):
                yield topic, sample
                continue
            frame, image = next(frames), encode(sample)
            damaged = replace(image, data=image.data.replace(b"IHDR", b"XXXX"))
            for side in ("left", "right"):
                yield f"/ECM/{side}/image", damaged if (side, frame) in broken else image

    path = write_samples(tmp_path / "lossy.mcap", lossy(), {"scenario": "synthetic"})
    losses = []
    for jobs in (1, 2):
        recording = open_recording(path, SETUPS[0].profile)
        measure_runs(recording, SETUPS[:2], jobs=jobs)
        losses.append([one for one in recording.health.losses if one.kind is LossKind.IMAGE])
    assert losses[1] == losses[0]
    assert [loss.topic for loss in losses[0]] == ["/ECM/right/image", "/ECM/left/image", "/ECM/right/image"]


def test_one_method_on_a_log_without_truth_is_refused_before_the_work(tmp_path):
    path = write_log(tmp_path / "bare.mcap", change=without("/ground_truth/distance"))
    recording = open_recording(path, SETUPS[0].profile)
    images: list[int] = []
    with pytest.raises(RecordingError, match="ground_truth_distance"):
        measure_runs(replace(recording, on_progress=lambda done, _: images.append(done)), SETUPS[:1])
    assert not images
