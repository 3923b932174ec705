"""What results depend on: equal requests have one number, and whatever changes a result changes it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from svmdist.workflows.batch.identity import code_version, fingerprint, log_identity
from svmdist.workflows.batch.store import ResultStore
from svmdist.workflows.batch.task import LogFile

from svmdist.estimation.alarms import AlarmRules
from svmdist.recording.observations import Window
from svmdist.workflows.request import prepare
from tests.workflows.batch.jobs import CountJob


def test_another_process_finds_the_same_number() -> None:
    """Whatever its seed of hashes is."""
    code = (
        "from svmdist.workflows.batch.identity import fingerprint\n"
        "from svmdist.workflows.request import prepare\n"
        "print(fingerprint(prepare(method='fused')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == fingerprint(prepare(method="fused"))


def test_what_changes_a_result_changes_the_number(tmp_path: Path) -> None:
    setup = prepare(method="fused")
    other_limits = setup.profile.limits.model_copy(update={"pair_tolerance_s": 0.003})
    model = tmp_path / "model.onnx"
    model.write_bytes(b"one")
    requests: list[object] = [
        setup,
        prepare(method="kinematic"),
        replace(setup, profile=setup.profile.model_copy(update={"limits": other_limits})),
        Window(every=2),
        Window(every=3),
        AlarmRules(0.005),
        {"image": "/a"},
        {"image": "/b"},
        np.array([1.0, 2.0]),
        np.array([[1.0, 2.0]]),
        0.1 + 0.2,
        0.3,
        None,
        model,
    ]
    numbers = [fingerprint(one) for one in requests]
    assert len(set(numbers)) == len(requests)
    assert numbers == [fingerprint(one) for one in requests]
    model.write_bytes(b"two")
    assert fingerprint(model) != numbers[-1]
    with pytest.raises(TypeError, match="cannot be described"):
        fingerprint(object())


def test_a_log_is_known_by_its_content(tmp_path: Path) -> None:
    """Not by its name or place; its result is by content, name and request."""
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(b"the same")
    a, b = (log_identity(tmp_path / name) for name in ("a.mcap", "b.mcap"))
    assert a == b
    store = ResultStore(tmp_path / "results", CountJob(tmp_path))
    other = ResultStore(tmp_path / "results", CountJob(tmp_path, held=("x",)))
    log = LogFile(tmp_path / "a.mcap", "day/a ü")
    places = {
        store.place(log, a),
        store.place(replace(log, name="c"), a),
        store.place(log, "x"),
        other.place(log, a),
    }
    assert len(places) == 4
    assert store.place_of(log) == store.place(log, a)
    assert store.place_of(log).name.startswith("day-a-")
    (tmp_path / "a.mcap").write_bytes(b"another")
    assert store.place_of(log) != store.place(log, a)


def test_the_version_names_the_code() -> None:
    assert code_version().startswith("svmdist ")
    assert "numpy" in code_version()
