"""Comparing methods: the same figures as validating each alone, and a clock that is only read."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pytest

from svmdist.metrics import interval_coverage
from svmdist.recording.reader import open_recording
from svmdist.workflows.compare import ALL, compare
from svmdist.workflows.setup import prepare
from svmdist.workflows.truth import Reference, TruthRules
from svmdist.workflows.validate import validate


def test_figures_are_those_of_validate(golden: Path) -> None:
    """Per group and overall, R² and RMSE equal what `validate` gives for the method alone."""
    setups = [prepare(method=method) for method in ("overlay", "centroid")]
    recordings = [
        open_recording(golden / f"{name}.mcap", setups[0].profile) for name in ("sweep", "occlusion")
    ]
    ticks = count()
    scores = {(s.group, s.method): s for s in compare(recordings, setups, clock=lambda: float(next(ticks)))}
    assert set(scores) == {(g, m) for g in ("sweep", "occlusion", ALL) for m in ("overlay", "centroid")}
    rules = TruthRules(references=(Reference.GROUND_TRUTH,))
    for setup in setups:
        validation = validate(recordings, setup, rules)
        for score in (*validation.scores, *validation.overall):
            group = ALL if score.recording == "overall" else score.recording
            compared = scores[group, setup.method]
            assert compared.coverage == score.coverage
            assert compared.planar is not None
            assert score.statistics is not None
            assert compared.planar.statistics.rmse == pytest.approx(score.statistics.rmse, rel=1e-12)
            assert compared.planar.statistics.r_squared == pytest.approx(
                score.statistics.r_squared, rel=1e-12
            )
            # A planar method tells no clearance, and one tick a frame passes on this clock.
            assert compared.clearance is None
            assert compared.ms_per_frame == pytest.approx(1000.0)


def test_interval_coverage_is_honest_for_normal_errors() -> None:
    """Errors drawn with the stated deviation lie inside the 95 % interval 95 % of the time, half of it 67 %."""
    error = np.random.default_rng(0).normal(0.0, 2.0, 20_000)
    assert interval_coverage(error, np.zeros(20_000), np.full(20_000, 2.0)) == pytest.approx(0.95, abs=0.005)
    assert interval_coverage(error, np.zeros(20_000), np.full(20_000, 1.0)) == pytest.approx(0.673, abs=0.01)
    assert interval_coverage([], [], []) is None
