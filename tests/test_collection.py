"""The tests' names: workers share the tests out by them, so that each process must collect the same ones."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY

LIMIT_S = 600.0
"""A collection takes about 6 s of CPU time. One that has not ended by then is killed, which fails the test."""
COLLECT = """
import sys, time
now, now_ns, shift_s = time.time, time.time_ns, int(sys.argv[1])
time.time, time.time_ns = lambda: now() + shift_s, lambda: now_ns() + shift_s * 10**9
import pytest
options = ["-o", "addopts=", "-p", "no:cacheprovider", "--collect-only", "-q"]
sys.exit(pytest.main([*options, "tests"]))
"""


def collected(hash_seed: int, shift_s: int) -> list[str]:
    """The ids of all tests, of a process with this order of hashes and a clock that is ahead by so much."""
    # A worker's variables would make this process one.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        [sys.executable, "-c", COLLECT, str(shift_s)],
        cwd=REPOSITORY,
        env={**environment, "PYTHONHASHSEED": str(hash_seed)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=LIMIT_S,
    )
    assert done.returncode == pytest.ExitCode.OK, done.stdout[-2000:] + done.stderr
    return [line for line in done.stdout.splitlines() if "::" in line]


@pytest.mark.slow
def test_collections_are_equal_and_readable() -> None:
    r"""The same tests in the same order, whatever the order of a set and the time of day (a day and 7 s apart).

    Their names are printable ASCII. pytest writes other characters as \x.., \u.. or \n; `\\` is a backslash.
    """
    ids = collected(1, 0)
    assert len(ids) > 500
    assert collected(2, 86_407) == ids
    assert [test for test in ids if not (test.isascii() and test.isprintable())] == []
    assert [test for test in ids if "\\" in test.replace("\\\\", "")] == []
