"""Nothing is left in the temporary folder, or beside an output file, after a command: ended, terminated or killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

LOG = str(REPOSITORY / "recordings" / "sweep.mcap")
COMMANDS = {
    "table": ["estimate", LOG, "-o", "rows.csv"],
    "parquet": ["estimate", LOG, "-o", "rows.parquet"],
    "many logs": [
        "estimate",
        LOG,
        str(REPOSITORY / "recordings" / "random.mcap"),
        "--jobs",
        "2",
        "-o",
        "m.csv",
    ],
    "report": ["validate", LOG, "--report", "report.html"],
    "calibration": ["calibrate", str(REPOSITORY / "recordings" / "calibration.mcap"), "-o", "c.toml"],
    "kinematics": ["fk", LOG, "-o", "fk.csv"],
}


def _left(folder: Path, arguments: list[str], after_s: float | None, number: int = 0) -> tuple[int, set[str]]:
    """The exit code, and the files in the temporary folder and beside the output."""
    (folder / "tmp").mkdir(exist_ok=True)
    command = subprocess.Popen(
        [sys.executable, "-m", "svmdist", *arguments],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder / "tmp"), "PYTHONPATH": str(REPOSITORY)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    if after_s is not None:
        time.sleep(after_s)
        command.send_signal(number)
    code = command.wait(timeout=300)
    deadline = time.monotonic() + 10.0
    while list((folder / "tmp").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.1)  # workers notice that their parent was killed
    return code, {path.name for path in (*folder.iterdir(), *(folder / "tmp").iterdir())} - {"tmp"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("arguments", COMMANDS.values(), ids=COMMANDS)
def test_nothing_is_left(tmp_path: Path, arguments: list[str]) -> None:
    """A killed command leaves at most its `.part` beside the target, which the next one removes."""
    output = {arguments[-1]}
    for after_s in (0.7, 1.5, 2.2):
        _, left = _left(tmp_path, arguments, after_s, signal.SIGTERM)
        assert left <= output
        _, left = _left(tmp_path, arguments, after_s, signal.SIGKILL)
        assert all(name in output or name.endswith(".part") for name in left)
    (tmp_path / arguments[-1]).unlink(missing_ok=True)  # which an earlier one may have finished
    code, left = _left(tmp_path, arguments, None)
    assert (code, left) == (0, output)
