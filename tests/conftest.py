"""Fixtures that several test folders share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from tests.golden import RECORDINGS, GoldenRuns
from tests.synthetic import write_log

REPOSITORY = Path(__file__).resolve().parent.parent

# The same examples in every run, whatever an earlier one found; `--hypothesis-profile=default` draws new ones.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Run one file's tests and what is debugged in this process: without others, and to be seen."""
    files = {name.partition("::")[0] for name in config.args}
    is_one_file = len(files) == 1 and files.pop().endswith(".py")
    if is_one_file or config.option.usepdb:
        config.option.numprocesses = 0


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """The parameter's name in place of what a file holds: bytes and several lines may change with the clock."""
    is_content = isinstance(val, bytes) or (isinstance(val, str) and not val.isprintable())
    return argname if is_content else None


@pytest.fixture(scope="session")
def synthetic_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 40 frames drawn with OpenCV, with exact geometry."""
    return write_log(tmp_path_factory.mktemp("synthetic") / "synthetic.mcap", frame_count=40)


@pytest.fixture(scope="session")
def synthetic_calibration(synthetic_log: Path) -> Path:
    """A calibration fitted on the synthetic log."""
    from svmdist.estimation.plane_mapping import save_calibration
    from svmdist.profile import load_profile
    from svmdist.recording.log import open_recording
    from svmdist.workflows.calibrate import collect_part, fit_parts

    profile = load_profile()
    path = synthetic_log.with_suffix(".calibration.toml")
    save_calibration(
        fit_parts([collect_part(open_recording(synthetic_log, profile), profile, "overlay")], "overlay"), path
    )
    return path


@pytest.fixture(scope="session")
def golden() -> Path:
    """The folder of golden logs."""
    return RECORDINGS


@pytest.fixture(scope="session")
def golden_rows(tmp_path_factory: pytest.TempPathFactory) -> GoldenRuns:
    """Rows of methods on golden logs: `golden_rows("3d/contact", "fused")`, measured once in the whole run."""
    base = tmp_path_factory.getbasetemp()
    return GoldenRuns(base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base)
