"""What several test folders share: the command line, here and in a process of its own, and logs."""

import csv
import json
import os
import signal
import subprocess
import sys
import tarfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from svmdist.cli.main import run
from tests.golden import RECORDINGS, GoldenRuns
from tests.synthetic import write_log

REPOSITORY = Path(__file__).resolve().parent.parent
LIMIT_S = 300.0
"""A process that has not ended by then hangs; all of them need a few seconds, on a busy machine too."""

# The same examples in every run, whatever an earlier one found, without a limit on their time;
# `--hypothesis-profile=default` draws new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Run one file's tests and what is debugged in this process: without others, and to be seen."""
    files = {name.partition("::")[0] for name in config.args}
    is_one_file = len(files) == 1 and files.pop().endswith(".py")
    if is_one_file or config.option.usepdb:
        config.option.numprocesses = 0


FAST_FOLDERS = {"tests", "geometry", "importing", "kinematics", "profile", "recording", "report", "vision"}
NOT_FAST_FILES = {
    *("annotated", "api", "auto", "distance", "drawing", "faults", "golden", "network", "packaging", "plots"),
    *("remote", "training"),
}
NOT_FAST_FIXTURES = {"cli", "golden", "golden_rows"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as fast what needs no command, golden log or process, and was measured to end in half a minute together."""
    for item in items:
        is_heavy = item.path.stem.removeprefix("test_") in NOT_FAST_FILES
        is_heavy |= any(item.get_closest_marker(name) for name in ("slow", "fault"))
        is_heavy |= bool(NOT_FAST_FIXTURES & {*getattr(item, "fixturenames", ())})
        if item.path.parent.name in FAST_FOLDERS and not is_heavy:
            item.add_marker(pytest.mark.fast)


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """The parameter's name in place of what a file holds: bytes and several lines may change with the clock."""
    is_content = isinstance(val, bytes) or (isinstance(val, str) and not val.isprintable())
    return argname if is_content else None


@dataclass(frozen=True)
class Outcome:
    """What a command left: its exit code, stdout and stderr."""

    code: int
    out: str
    err: str

    @property
    def rows(self) -> list[dict[str, str]]:
        return list(csv.DictReader(self.out.splitlines()))

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def line(self) -> str:
        return one_line(self.err)


Cli = Callable[..., Outcome]


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """Run `svmdist` with arguments in this process; unless another one is named, the exit code is 0."""

    def call(*arguments: object, code: int = 0) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["svmdist", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            run()
        captured = capsys.readouterr()
        assert int(exit_info.value.code or 0) == code, captured.err
        return Outcome(code, captured.out, captured.err)

    return call


def ended(*arguments: object, **options: Any) -> subprocess.CompletedProcess[Any]:
    """Run `svmdist` to its end in a process of its own, with the options of `subprocess.run`."""
    defaults = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "encoding": "utf-8",
        "errors": "replace",
    }
    environment = {**os.environ, **options.pop("environment", {})}
    command = [sys.executable, "-m", "svmdist", *map(os.fspath, map(_text, arguments))]
    return subprocess.run(command, env=environment, timeout=LIMIT_S, check=False, **(defaults | options))


def _text(argument: object) -> str | Path:
    return argument if isinstance(argument, Path) else str(argument)


@contextmanager
def started(*arguments: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Begin `svmdist` in a process that hears interrupts, with the options of `Popen`, and make sure that it ends.

    A shell starts what it runs in the background with interrupts ignored, and `nohup` with hang-ups, and so would
    children of the tests begin: they have the default where their parent has a handler.
    """
    command = [sys.executable, "-u", "-m", "svmdist", *map(str, arguments)]
    heard = [getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)]
    before = [signal.signal(number, signal.default_int_handler) for number in heard]
    try:
        process = subprocess.Popen(command, text=True, start_new_session=True, **options)
    finally:
        for number, handler in zip(heard, before, strict=True):
            signal.signal(number, handler)
    watchdog = threading.Timer(LIMIT_S, process.kill)
    watchdog.start()
    try:
        with process:
            try:
                yield process
            finally:
                process.kill()  # does nothing to one that has ended
    finally:
        watchdog.cancel()


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a tar, with the filter of archives that Python has from 3.11.4 on."""
    with tarfile.open(archive) as files:
        files.extraction_filter = getattr(tarfile, "data_filter", None)
        files.extractall(folder)


def one_line(err: str) -> str:
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]


@pytest.fixture(scope="session")
def synthetic_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 40 frames drawn with OpenCV, with exact geometry."""
    return write_log(tmp_path_factory.mktemp("synthetic") / "synthetic.mcap", frame_count=40)


@pytest.fixture(scope="session")
def synthetic_calibration(synthetic_log: Path) -> Path:
    """A calibration fitted on the synthetic log."""
    from svmdist.estimation.plane_mapping import save_calibration
    from svmdist.profile import load_profile
    from svmdist.workflows.calibrate import collect_part, fit_parts
    from svmdist.workflows.request import Request, Setup

    request, path = Request(Setup(load_profile(), "overlay")), synthetic_log.with_suffix(".calibration.toml")
    save_calibration(fit_parts([collect_part(request.open(synthetic_log, "log"), request)], "overlay"), path)
    return path


@pytest.fixture(scope="session")
def calibrated(synthetic_log: Path, synthetic_calibration: Path) -> tuple[object, ...]:
    """The synthetic log with its calibration, as arguments of a command."""
    return (synthetic_log, "--calibration", synthetic_calibration)


@pytest.fixture(scope="session")
def golden() -> Path:
    return RECORDINGS


@pytest.fixture(scope="session")
def golden_rows(tmp_path_factory: pytest.TempPathFactory) -> GoldenRuns:
    """Rows of methods on golden logs: `golden_rows("3d/contact", "fused")`, measured once in the whole run."""
    base = tmp_path_factory.getbasetemp()
    return GoldenRuns(base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base)
