"""Batch runs ended by KILL, TERM and INT at any time: what has its name is whole; going on gives the same."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.batch.store import SCHEMA, stored_rows
from tests.cli.running import require_no_traceback, started
from tests.synthetic import write_log

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def run(arguments: list[str], number: signal.Signals | None = None, after_s: float = 0.0) -> tuple[int, str]:
    """Run svmdist, and end it after a while where a signal is given; its exit code and what it said."""
    process = started(*arguments)
    try:
        _, err = process.communicate(timeout=None if number is None else after_s)
    except subprocess.TimeoutExpired:
        assert number is not None
        process.send_signal(number)
        _, err = process.communicate(timeout=120)
    require_no_traceback(err)
    return process.returncode, err


def kills(
    count: int,
    seed: int,
    span_s: float,
    arguments: list[str],
    check: Callable[[bool], None],
    clear: Callable[[], None],
) -> Counter[str]:
    """End a command so often, at random times; begin anew once it has come to its end. How the runs ended."""
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    attempt = 0
    while attempt < count:
        code, _ = run(arguments, SIGNALS[attempt % 3], rng.uniform(0.0, span_s))
        attempt += 1
        is_done = code == 0
        found["done" if is_done else "ended"] += 1
        check(is_done)
        if is_done:
            clear()
    code, err = run(arguments)
    assert code == 0, err
    check(True)
    return found


@pytest.mark.parametrize("count", [1, pytest.param(100, marks=pytest.mark.fault)])
def test_kills_of_estimate(tmp_path: Path, count: int) -> None:
    """The file of all rows is there whole or not at all; so is each log's result; the last run finds the same rows."""
    logs = tmp_path / "logs"
    logs.mkdir()
    for number in range(6):
        write_log(logs / f"log{number}.mcap", frame_count=4 + number)
    reference, output, results = tmp_path / "reference.csv", tmp_path / "rows.csv", tmp_path / "results"
    common = ["estimate", str(logs), "--jobs", "2"]
    assert run([*common, "-o", str(reference)])[0] == 0
    expected = reference.read_bytes()

    def check(is_done: bool) -> None:
        if is_done or output.exists():
            assert output.read_bytes() == expected
        for document in results.glob("*.json"):
            stored = json.loads(document.read_text())
            rows = list(stored_rows(document.with_suffix(".jsonl")))
            assert stored["schema"] == SCHEMA
            assert len(rows) == stored["row_count"] > 0
        for rows_file in results.glob("*.jsonl"):
            assert all(row["status"] for row in stored_rows(rows_file))

    def clear() -> None:
        shutil.rmtree(results)
        output.unlink()

    found = kills(count, 1, 4.0, [*common, "-o", str(output), "--resume", str(results)], check, clear)
    if count > 50:
        assert min(found["done"], found["ended"]) > 5, "the signals did not meet the command at work"
    # Nothing is left of the runs that were ended but results.
    assert not [file for file in tmp_path.rglob(".*.part") if not _is_of_a_living(file)]


def _is_of_a_living(file: Path) -> bool:
    process = file.name.split(".")[-2]
    return os.path.exists(f"/proc/{process}")


@pytest.mark.fault
@pytest.mark.parametrize("count", [100])
def test_kills_of_episodes(tmp_path: Path, count: int) -> None:
    """A recording that has its name is whole; going on gives the files of an undisturbed run, byte for byte."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    common = ["record", "--episodes", "4", "--duration", "0.4", "--rate", "5", "--jobs", "2"]
    reference, folder = tmp_path / "reference", tmp_path / "episodes"
    assert run([*common, "-o", str(reference)])[0] == 0
    expected = {path.name: path.read_bytes() for path in reference.iterdir()}
    assert len(expected) == 4

    def check(is_done: bool) -> None:
        found = {path.name: path.read_bytes() for path in folder.glob("*.mcap")} if folder.exists() else {}
        assert found.items() <= expected.items()
        if is_done:
            assert found == expected
            recording = open_recording(folder / "sweep-1.mcap", load_profile())
            assert len(list(recording.images())) == 2

    found = kills(
        count, 2, 5.0, [*common, "-o", str(folder), "--skip-existing"], check, lambda: shutil.rmtree(folder)
    )
    if count > 50:
        assert min(found["done"], found["ended"]) > 5, "the signals did not meet the command at work"
    assert {path.name for path in folder.iterdir()} == set(expected)
