"""Comparing methods: the same figures as validating each alone, a clock that is only read, groups by metadata."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.report.scores import compare_results
from svmdist.report.tables import render
from svmdist.samples import ImageSample
from svmdist.simulation.scene import Options
from svmdist.vision.degradations import Degradation
from svmdist.workflows.compare import Group, compare, group_of
from svmdist.workflows.references import Reference, TruthRules
from svmdist.workflows.request import CLEAN, Condition, Request, prepare
from svmdist.workflows.validate import validate
from tests.synthetic import make_scene, samples

SMOKE = Condition(Degradation.SMOKE, 3)
PLAIN = Options()


def log(
    path: Path, scenario: str, frame_count: int = 4, extras: Options = PLAIN, lost: Container[int] = ()
) -> Path:
    """A drawn log with the metadata that `record` writes for these extras; lost frames are black."""
    frames = count()
    with RecordingWriter(path, {"scenario": scenario} | extras.metadata()) as writer:
        for topic, sample in samples(make_scene(), frame_count):
            is_lost = isinstance(sample, ImageSample) and next(frames) in lost
            writer.write(topic, replace(sample, image_bgr=0 * sample.image_bgr) if is_lost else sample)
    return path


def test_figures_are_those_of_validate(tmp_path: Path, synthetic_calibration: Path) -> None:
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
            assert compared.planar is not None
            assert score.statistics is not None
            assert compared.planar.statistics.rmse == pytest.approx(score.statistics.rmse, rel=1e-12)
            assert compared.planar.statistics.r_squared == pytest.approx(
                score.statistics.r_squared, rel=1e-12
            )
            assert compared.clearance is None  # of a planar method
            assert compared.ms_per_frame > 0.0


def test_groups_are_scenarios_and_recorded_degradations(tmp_path: Path) -> None:
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
    counts = {str(score.group): score.figures.frame_count for score in scores}
    assert counts == {
        "sweep": 4,
        "sweep smoke=3": 4,
        "contact smoke=3": 8,
        "all clean": 4,
        "all smoke=3": 12,
        "all": 16,
    }
    results = compare_results(scores)
    rows = list(results.rows)
    assert all(set(row) == set(results.keys) for row in rows)
    assert [(row["scenario"], row["degradation"]) for row in rows][:2] == [
        ("sweep", ""),
        ("sweep", "smoke=3"),
    ]
    shown = "".join(render(table) for table in results.tables)
    assert "contact smoke=3: 1 methods on 8 frames" not in shown
    assert "contact smoke=3: 1 method on 8 frames" in shown
    assert max(map(len, shown.splitlines())) <= 100


def test_degrading_at_replay_stands_beside_what_was_recorded(tmp_path: Path) -> None:
    """A condition adds a group; on a log that was recorded degraded its name follows the recorded one."""
    profile = load_profile()
    noisy = log(tmp_path / "noisy.mcap", "sweep", extras=Options(degradations=(("noise", 1), ("jpeg", 2))))
    recording = open_recording(noisy, profile)
    assert str(group_of(recording, CLEAN)) == "sweep noise=1,jpeg=2"
    assert str(group_of(recording, SMOKE)) == "sweep noise=1,jpeg=2,smoke=3"
