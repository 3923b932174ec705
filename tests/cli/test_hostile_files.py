"""Files and paths that nobody would write by hand: each gets one line that names it, at once, and exit code 1 or 2."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import ended
from tests.shipped import write_profile

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's pipes and devices")


def named(folder: Path, kind: str, name: str) -> Path:
    """A pipe without a writer, or a device without an end, under a name."""
    path = folder / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


NETWORK = """[segmentation]
method = "onnx"
model = "{path}"
width_px = 64
height_px = 64
tissue = {{ class_ids = [1], min_area_px = 9 }}
instrument = {{ class_ids = [2], min_area_px = 9 }}
"""


def as_mesh(path: Path) -> list[object]:
    mesh = path.rename(path.with_suffix(".obj"))
    dome = (r"(?s)\[tissue\.dome\].*?(?=\[simulation\])", f'mesh = "{mesh}"\n')
    profile = write_profile(path.with_name("mine.toml"), dome)
    return ["estimate", "x.mcap", "--method", "fused", "--profile", profile]


def as_network(path: Path) -> list[object]:
    colours = (r"(?s)\[segmentation\.tissue\].*?(?=\[marker\])", NETWORK.format(path=path))
    profile = write_profile(path.with_name("mine.toml"), colours)
    return ["estimate", "x.mcap", "--method", "fused", "--profile", profile]


def as_member(path: Path) -> list[object]:
    path.rename(path.with_name("bag_0.mcap"))
    names = "rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap]}\n"
    path.with_name("metadata.yaml").write_text(names)
    return ["info", path.parent]


USES: dict[str, Callable[[Path], list[object]]] = {
    "profile": lambda path: ["info", "x.mcap", "--profile", path.rename(path.with_suffix(".toml"))],
    "calibration": lambda path: ["estimate", "x.mcap", "--calibration", path],
    "mesh": as_mesh,
    "network": as_network,
    "recording": lambda path: ["estimate", path],
    "video": lambda path: ["import", path, "--camera", "60,61,31,23", "-o", "x.mcap"],
    "metadata": lambda path: ["info", path.rename(path.with_name("metadata.yaml")).parent],
    "file of a bag": as_member,
}


@LINUX
@pytest.mark.parametrize(("use", "kind"), [*((use, "pipe") for use in USES), ("recording", "zeros")])
def test_what_is_no_regular_file_is_not_waited_for(tmp_path, use, kind):
    """A pipe would be waited for without end, and a device fill the memory."""
    done = ended(*USES[use](named(tmp_path, kind, "it")), cwd=tmp_path)
    assert done.returncode == 1
    said = ("regular file", "without metadata.yaml", "expected a .mcap or .db3 file")
    assert any(fragment in done.stderr for fragment in said)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("length", [254, 255, 256, 300])
@pytest.mark.parametrize("command", ["info", "profile", "output", "record"])
def test_long_names(cli, tmp_path, synthetic_log, command, length):
    """A name that the file system does not know how to keep is one line; the longest that it keeps is written."""
    path = tmp_path / ("n" * (length - 5) + ".toml")
    arguments: dict[str, list[object]] = {
        "info": ["info", path],
        "profile": ["info", "x.mcap", "--profile", path],
        "output": ["info", synthetic_log, "-f", "csv", "-o", path],
        "record": ["record", "--duration", "0.2", "--rate", "5", "-o", path],
    }
    if command == "record":
        pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    if command == "output" and length <= 255:
        assert cli(*arguments[command]).err == ""
        assert list(tmp_path.iterdir()) == [path]
    else:
        assert path.name[:100] in cli(*arguments[command], code=1).line
