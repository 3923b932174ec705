"""Log and profile against each other: what `svmdist check` says, and what a contradiction does to rows."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.log_changes import opened, optics
from svmdist.estimation.comparison import Checks, Difference
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from tests.golden import RECORDINGS
from tests.shipped import write_profile

CONTACT = RECORDINGS / "3d" / "contact.mcap"


@pytest.mark.parametrize("log", ["3d/contact", "3d/duo", "real/contact", "real/random", "sweep"])
def test_nothing_contradicts_in_golden_logs(cli: Any, log: str):
    """Every comparison agrees; one camera has fewer of them."""
    rows = cli("check", RECORDINGS / f"{log}.mcap", "-f", "json").json
    assert rows
    assert {row["verdict"] for row in rows} == {"agrees"}
    has_surface = any(row["what"] == "height of the tissue" for row in rows)
    assert has_surface == (log != "sweep")


@pytest.mark.parametrize(("distance_m", "verdict", "code"), [(0.108, "agrees", 0), (0.125, "contradicts", 4)])
def test_a_plane_is_compared_as_a_dome_is(cli: Any, tmp_path: Path, distance_m, verdict, code):
    """Through the middle of an organ of 8 mm it agrees with what both views show, farther it does not."""
    path = write_profile(
        tmp_path / "plane.toml",
        (r"\[tissue\.dome\]\n(.+\n)+", ""),
        ("plane_distance_m = 0.112", f"plane_distance_m = {distance_m}"),
        ("surface_std_m = 5e-5", "surface_std_m = 3e-3"),
    )
    rows = cli("check", CONTACT, "--profile", path, "-f", "json", code=code).json
    assert {row["what"]: row["verdict"] for row in rows}["height of the tissue"] == verdict


MISTAKES = [
    ("plane_distance_m", "0.125", "height of the tissue", "shaft"),
    ("shaft_radius_m", "0.008", "depth of the tool", "shaft"),
    ("size_m", "0.0056", "depth of the tool", "fiducial"),
]


@pytest.mark.parametrize(("key", "value", "what", "method"), MISTAKES)
def test_a_wrong_profile_is_named(cli: Any, tmp_path: Path, key, value, what, method):
    """By what does not agree, with what it could be; no row that rests on it is ok, and one line warns."""
    profile = write_profile(tmp_path / "mine.toml", (rf"(?m)^{key} = .*$", f"{key} = {value}"))
    rows = cli("check", CONTACT, "--profile", profile, "-f", "json", code=4).json
    found = [row for row in rows if row["verdict"] == "contradicts"]
    assert what in {row["what"] for row in found}
    assert all(row["deviations"] > 3.5 and row["could_be"] for row in found)
    few = ("--every", 4, "-f", "json")
    ran = cli("estimate", CONTACT, "--profile", profile, "--method", method, *few, code=3)
    assert not any(row["status"] == "ok" for row in json.loads(ran.out))
    assert [line for line in ran.err.splitlines() if "warning" in line and "contradict" in line]


DUO = RECORDINGS / "3d" / "duo.mcap"


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of two instruments with a right focal length that is off by 3 %."""
    folder = tmp_path_factory.mktemp("bent")
    case = opened(str(DUO), "psm13", "two", folder)
    optics(lambda K: K * [[0.97, 1, 1], [1, 0.97, 1], [1, 1, 1]], "right_camera_info")(case)
    case.write(folder / "bent.mcap")
    return folder / "bent.mcap"


@pytest.mark.parametrize("method", ["stereo", "fused"])
def test_rows_that_bend_are_aligned(cli: Any, bent: Path, method: str):
    """`stereo` covers what that does, `fused` keeps to the left view; both warn."""
    truth = open_recording(DUO, load_profile("psm13")).distance_track()
    ran = cli("estimate", bent, "--method", method, "--every", 8, "-f", "json", code=3)
    assert "rows of both views" in ran.err
    rows = [row for row in json.loads(ran.out) if row["status"] == "ok" and row["instrument"] == "PSM1"]
    assert len(rows) > 5
    true_m = truth.at(np.array([row["stamp_ns"] for row in rows], np.int64)).values[:, 2]
    off = [abs(row["clearance_m"] - m) / row["clearance_std_m"] for row, m in zip(rows, true_m, strict=True)]
    assert np.max(off) < 2.5


def test_what_is_infinitely_unsure_is_not_compared():
    """It would count as an agreement, and JSON has no word for it."""
    sure, unsure = (Difference("place", ("a", "b"), 1.0, std, "px") for std in (2.0, np.inf))
    assert Checks.of([unsure], 1).comparisons == ()
    (one,) = Checks.of([unsure, sure], 2).comparisons
    assert (one.usual, one.frames) == (sure, 1)
