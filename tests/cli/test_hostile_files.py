"""Files and paths that nobody would write by hand: each gets one line that names it, at once, and exit code 1 or 2."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from svmdist.profile import SHIPPED
from tests.conftest import ended

PSM13 = (SHIPPED / "psm13.toml").read_text("utf-8")
DEEP, DEEP_TABLES, DIGITS = "[" * 10_000 + "]" * 10_000, "{b=" * 10_000 + "1" + "}" * 10_000, "9" * 5_000
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's pipes and devices")


def named(folder: Path, kind: str, name: str) -> Path:
    """A pipe without a writer, or a device without an end, under a name."""
    path = folder / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


def changed(path: Path, first: str, last: str, new: str) -> Path:
    """The shipped profile with other tables from one to before another, beside a path."""
    profile = path.with_name("mine.toml")
    profile.write_text(PSM13[: PSM13.index(first)] + new + PSM13[PSM13.index(last) :])
    return profile


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
    profile = changed(path, "[tissue.dome]", "[simulation]", f'mesh = "{mesh}"\n')
    return ["estimate", "x.mcap", "--method", "fused", "--profile", profile]


def as_network(path: Path) -> list[object]:
    profile = changed(path, "[segmentation.tissue]", "[marker]", NETWORK.format(path=path))
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
    "metadata": lambda path: ["info", path.rename(path.with_name("metadata.yaml")).parent],
    "file of a bag": as_member,
}


@LINUX
@pytest.mark.parametrize("kind", ["pipe", "zeros"])
@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_what_is_no_regular_file_is_not_waited_for(tmp_path, kind, use):
    """A pipe would be waited for without end, and a device fill the memory."""
    done = ended(*use(named(tmp_path, kind, "it")), cwd=tmp_path)
    assert done.returncode == 1
    said = ("regular file", "without .mcap", "without any .mcap or .db3 file")
    assert any(fragment in done.stderr for fragment in said)
    assert "Traceback" not in done.stderr


def psm13_with(old: str, new: str) -> str:
    assert old in PSM13
    return PSM13.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[robot]\njoints = " + DEEP + "\n", "nested too deeply"),
        ("a = " + DEEP_TABLES + "\n", "nested too deeply"),
        ('name = "x"\n[features]\nfeature_count = ' + DIGITS, "value has 5000 digits"),
        ("[" + "a." * 10_000 + "b]\n", "unknown key a"),
        (PSM13 + "[camera_error]\nfocal_std_fraction = 1e308\n", "camera_error.focal_std_fraction"),
        (psm13_with("distance_std_m = 1.0e-3", "distance_std_m = 1e308"), "tissue.plane_distance_std_m"),
        (psm13_with("a_m = 0.43", "a_m = 1e308"), "robot.joints.1.a_m"),
        (psm13_with("shaft_radius_m = 0.004", "shaft_radius_m = 1e-308"), "instrument.shaft_radius_m"),
        (psm13_with("[0.0, 0.0085, 0.0046]", "[0.0, -1e308, 0.0]"), "fiducial.position_m"),
    ],
    ids=["lists", "tables", "digits", "dotted", "fraction", "deviation", "length", "radius", "position"],
)
def test_a_profile_without_measure(cli, tmp_path, text, said):
    """What would overflow when it is squared is refused where it stands, not warned of by NumPy later."""
    path = tmp_path / "mine.toml"
    path.write_text(text)
    line = cli("info", "x.mcap", "--profile", path, code=1).line
    assert "mine.toml" in line
    assert said in line


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
