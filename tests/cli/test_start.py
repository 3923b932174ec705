"""A command loads what it uses, and no more: importing is most of what a short log costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.recording.builders import scene, write_scene

UNUSED = ("rich", "matplotlib", "pybullet", "sqlite3", "yaml")
SAY_LOADED = """
import sys
sys.argv = ["svmdist", *{arguments!r}]
from svmdist.__main__ import run
try:
    run()
except SystemExit:
    pass
sys.stderr.write("loaded: " + " ".join(name for name in {unused!r} if name in sys.modules))
"""


@pytest.mark.parametrize("form", ["table", "csv", "json"])
def test_estimating_loads_no_layout_and_no_other_format(tmp_path: Path, form: str) -> None:
    """Rows are written as they come; the log is MCAP with zstd."""
    log = write_scene(tmp_path / "a.mcap", scene(1))
    arguments = ["estimate", str(log), "--format", form, "--equations", "printed"]
    code = SAY_LOADED.format(arguments=arguments, unused=UNUSED)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "loaded: "
    assert "corrupt" in done.stdout or "no_" in done.stdout
