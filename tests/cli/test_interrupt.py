"""Ctrl-C and kills: one line, exit code 130, no traceback, whatever the command is doing; and nothing is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample
from tests.conftest import REPOSITORY, started
from tests.reading import read_images

INTERRUPTED, TERMINATED = "svmdist: interrupted", "svmdist: terminated"


@pytest.mark.parametrize(
    "request_",
    [
        *(f"{name} x.mcap" for name in ("info", "estimate", "validate", "compare", "blur-bench", "fk")),
        "calibrate x.mcap -o c.toml",
        "record -o r.mcap",
    ],
)
def test_every_command(cli, tmp_path, monkeypatch, request_):
    """An interrupt in the middle of the work of each command ends it so, and leaves no file."""

    def interrupted(*_: object, **__: object) -> NoReturn:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    busy = "record.record" if request_.startswith("record") else "request.open_recording"
    monkeypatch.setattr(f"svmdist.workflows.{busy}", interrupted)
    outcome = cli(*request_.split(), code=130)
    assert (outcome.out, outcome.line) == ("", INTERRUPTED)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [(signal.SIGINT, 130, INTERRUPTED), (signal.SIGTERM, 143, TERMINATED), (signal.SIGHUP, 129, TERMINATED)],
    ids=["INT", "TERM", "HUP"],
)
@pytest.mark.parametrize("jobs", [1, 2])
def test_while_a_log_is_recorded(tmp_path, number, code, said, jobs):
    """A real signal between two frames: no log under its name, and what there is stays in its `.part`, readable."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    path, part = tmp_path / "r.mcap", tmp_path / "r.mcap.part"
    options = ("--duration", 60, "-j", jobs, "-o", path)
    with started("record", *options, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        while process.poll() is None and not (part.exists() and part.stat().st_size > 100_000):
            time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate()
    assert (process.returncode, out) == (code, "")  # PyBullet's own chatter goes nowhere
    lines = [line for line in err.splitlines() if "frames/s" not in line]  # the progress of a slow machine
    assert lines == [f"{said}; what was recorded until then is in {part}"]
    assert list(tmp_path.iterdir()) == [part]
    assert any(isinstance(image, ImageSample) for image in read_images(open_recording(part, load_profile())))


def test_with_a_progress_bar_on_a_terminal(golden):
    """The bar is taken off the terminal, the cursor comes back, and the line stands alone.

    All methods on all logs take a minute, of which the interrupt leaves the first moment.
    """
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    leader, follower = pty.openpty()
    logs = sorted(golden.glob("*.mcap"))
    with started("compare", *logs, stdout=subprocess.DEVNULL, stderr=follower) as process:
        os.close(follower)
        shown = b""
        while b"comparing" not in shown:
            shown += os.read(leader, 4096)
        process.send_signal(signal.SIGINT)
        while True:
            try:
                piece = os.read(leader, 4096)
            except OSError:  # the terminal is closed
                break
            if not piece:
                break
            shown += piece
        process.wait()
    os.close(leader)
    assert process.returncode == 130, shown.decode(errors="replace")
    assert b"Traceback" not in shown
    assert shown.count(INTERRUPTED.encode()) == 1
    assert shown.rindex(b"\x1b[?25h") < shown.index(INTERRUPTED.encode())


GOLDEN = REPOSITORY / "recordings"
COMMANDS = {
    "table": f"estimate {GOLDEN}/sweep.mcap -o rows.csv",
    "parquet": f"estimate {GOLDEN}/sweep.mcap -o rows.parquet",
    "many logs": f"estimate {GOLDEN}/sweep.mcap {GOLDEN}/random.mcap --jobs 2 -o m.csv",
    "report": f"validate {GOLDEN}/sweep.mcap --report report.html",
    "calibration": f"calibrate {GOLDEN}/calibration.mcap -o c.toml",
    "kinematics": f"fk {GOLDEN}/sweep.mcap -o fk.csv",
    "recording": "record --force --rate 10 -j 2 --duration 2.6 -o log.mcap",
    "episodes": "record --force --rate 10 -j 2 --duration 1 --episodes 2 -o folder",
}


def left_by(folder: Path, command: str, after_s: float | None, number: int = 0) -> tuple[int, set[str]]:
    """The exit code, and the files in the temporary folder and beside the output."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    there = {**os.environ, "TMPDIR": str(temporary), "PYTHONPATH": str(REPOSITORY)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with started(*command.split(), cwd=folder, env=there, **quiet) as process:
        if after_s is not None:
            time.sleep(after_s)
            process.send_signal(number)
        code = process.wait()
    deadline = time.monotonic() + 60.0
    while list(temporary.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.1)  # workers notice that their parent was killed
    return code, {path.name for path in (*folder.iterdir(), *temporary.iterdir())} - {"tmp"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_nothing_is_left_in_the_temporary_folder(tmp_path, command):
    """A killed command leaves at most its `.part`, which the next one replaces; `record` only with `--force`."""
    *_, output = command.split()
    kept = {output, f"{output}.part"} if command.startswith("record") else {output}
    for after_s in (0.7, 1.5, 2.2, 3.5):
        _, left = left_by(tmp_path, command, after_s, signal.SIGTERM)
        assert left <= kept
        _, left = left_by(tmp_path, command, after_s, signal.SIGKILL)
        assert all(name == output or name.endswith(".part") for name in left), left
    for path in [tmp_path / output, *(tmp_path / output).glob("*")]:  # which an earlier one may have finished
        if path.is_file():
            path.unlink()
    assert left_by(tmp_path, command, None) == (0, {output})
