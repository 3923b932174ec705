"""Parts in processes: results in order, progress by steps, and an end at once where something goes wrong."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

import pytest

from svmdist.errors import RecordingError, SvmdistError
from svmdist.workflows.processes import Advance, in_processes

LONG_S = 60.0
"""What no test may wait for."""


def steps(part: int, advance: Advance) -> tuple[int, int]:
    """So many steps; the longest part comes first."""
    for _ in range(part):
        advance()
    time.sleep(0.01 * part)
    return part, os.getpid()


def one_fails(part: int, _advance: Advance) -> None:
    if part == 0:
        raise RecordingError("broken")
    time.sleep(LONG_S)


def one_is_killed(part: int, _advance: Advance) -> None:
    if part == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(LONG_S)


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_results_come_in_the_parts_order(start: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From other processes, forked or not, no more of them than asked for; every step is told once."""
    if start not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system cannot {start}")
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: [start])
    told: list[int] = []
    parts = [8, 2, 0, 5, 1]
    results = in_processes(steps, parts, 2, lambda: told.append(1))
    assert [part for part, _ in results] == parts
    assert len(told) == sum(parts)
    processes = {process for _, process in results}
    assert os.getpid() not in processes
    assert len(processes) <= 2


def test_an_error_ends_all_at_once() -> None:
    """As itself, while another part would still take long; no process stays."""
    start_s = time.monotonic()
    with pytest.raises(RecordingError, match="broken"):
        in_processes(one_fails, [1, 0], 2, lambda: None)
    assert time.monotonic() - start_s < LONG_S / 2
    assert not multiprocessing.active_children()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system kills otherwise")
def test_a_killed_process_is_told_in_a_line() -> None:
    with pytest.raises(SvmdistError, match=r"was killed.*--jobs"):
        in_processes(one_is_killed, [1, 0], 2, lambda: None)
    assert not multiprocessing.active_children()
