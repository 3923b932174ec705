"""The page of worlds and methods: its cells are those of the pairs that it is made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.robustness import WORLDS, far_share, measure, robustness_page, robustness_table
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.workflows.conditions import PerturbedCondition
from svmdist.workflows.scoring.score import Pairs
from tests.synthetic import make_scene, samples


@pytest.mark.parametrize("world", WORLDS)
def test_every_world_is_one_that_a_replay_can_make(world: str) -> None:
    assert str(PerturbedCondition(parse_perturbations(world))) == world


def test_far_frames_are_counted_by_their_own_deviation() -> None:
    truth = np.zeros(4)
    std = np.array([1.0, 1.0, 0.1, np.nan])
    pairs = Pairs(np.arange(4), np.array([4.9, -5.1, 0.6, 100.0]), truth, std)
    assert far_share(pairs) == pytest.approx(2 / 3)
    assert far_share(Pairs(np.arange(1), truth[:1], truth[:1], std[3:])) is None


def test_the_page_has_a_row_for_every_world_and_one_for_logs_of_real_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.robustness.WORLDS", ("plane=1", "lag=30"))
    paths = []
    for name, told in {"plain": {}, "real": {"world": "real", "perturb": "focal=1"}}.items():
        paths.append(tmp_path / f"{name}.mcap")
        with RecordingWriter(paths[-1], {"scenario": "sweep", "seed": "1", **told}) as writer:
            for topic, sample in samples(make_scene(), 4):
                writer.write(topic, sample)
    profile = load_profile()
    runs = measure([open_recording(path, profile) for path in paths], ("kinematic", "fiducial"))
    assert [sum(run.statuses.values()) for run in runs] == [4] * 8
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in robustness_table(runs).splitlines()]
    assert [row[0] for row in rows] == ["what differs", "---", "nothing", "plane=1", "lag=30", "world=real"]
    rmse_mm = 1e3 * runs[0].spatial.statistics.rmse if runs[0].spatial else None
    assert rmse_mm is not None
    assert rows[2][1].split(" / ")[0] == f"{rmse_mm:.2f}"
    assert {row[2] for row in rows[2:]} == {"– / – / 0 / –"}  # no tag was mounted
    page = robustness_page(runs)
    assert "from logs of 8 frames" in page
    assert "- `svmdist record --scenario sweep --seed 1 --world real`" in page
