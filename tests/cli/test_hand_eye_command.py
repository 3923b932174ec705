"""`svmdist hand-eye` on simulated logs whose own transform is off by centimetres, and what uses the result."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import load_profile
from svmdist.profile.hand_eye import load_hand_eye
from svmdist.recording.log import open_recording
from svmdist.transforms import rotation_vector
from tests.cli.conftest import Cli
from tests.conftest import REPOSITORY

LOG = REPOSITORY / "recordings" / "real" / "random.mcap"
EXACT = REPOSITORY / "recordings" / "sweep.mcap"
"""A log of the same set-up whose transform is the true one."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hand-eye file of the log, by its tag."""
    from svmdist.profile.hand_eye import save_hand_eye
    from svmdist.report.info import hand_eye_file
    from svmdist.workflows.calibrate import HandEyeResult, hand_eye
    from svmdist.workflows.request import prepare

    setup = prepare("psm13", "fiducial")
    recording = open_recording(LOG, setup.profile)
    found = hand_eye(recording, setup, "PSM1")
    assert isinstance(found, HandEyeResult)
    path = tmp_path_factory.mktemp("hand-eye") / "he.toml"
    save_hand_eye(path, hand_eye_file([found], recording))
    return path


def test_the_true_transform_is_in_the_stated_ellipsoid(fitted: Path) -> None:
    """With joints that err by a degree and a log whose transform is centimetres off, 95 % holds the true one."""
    stated = load_hand_eye(fitted).of("PSM1")
    assert stated is not None
    true = open_recording(EXACT, load_profile()).transform_track("camera", "base").T_parent_child[0]
    T = stated.T_camera_base
    error = np.concatenate([true[:3, 3] - T[:3, 3], rotation_vector(true[:3, :3] @ T[:3, :3].T)])
    assert error @ np.linalg.solve(np.array(stated.covariance), error) < 12.6


def test_methods_use_it(cli: Cli, fitted: Path) -> None:
    """`kinematic` errs by millimetres in place of centimetres, and its interval still holds the truth."""
    errors = []
    for options in ((), ("--hand-eye", fitted)):
        outcome = cli(
            "validate", LOG, "--method", "kinematic", "--truth", "ground_truth", "-f", "json", *options
        )
        assert outcome.code == 0, outcome.err
        row = json.loads(outcome.out)
        text = json.dumps(row)
        errors.append(float(text.split('"spatial_rmse_m": ')[1].split(",")[0]))
        assert float(text.split('"spatial_interval_coverage": ')[1].split(",")[0]) >= 0.9
    assert errors[1] < 0.006
    assert errors[1] < 0.5 * errors[0]


def test_fk_in_the_camera(cli: Cli, fitted: Path) -> None:
    """Poses in the camera's frame are the base's poses under the fitted transform."""
    stated = load_hand_eye(fitted).of("PSM1")
    assert stated is not None
    rows = [
        list(csv.DictReader(io.StringIO(cli("fk", LOG, *options).out)))
        for options in ((), ("--in-camera", "--hand-eye", fitted))
    ]
    assert len(rows[0]) == len(rows[1]) > 0
    places = [np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in part]) for part in rows]
    T = stated.T_camera_base
    np.testing.assert_allclose(places[0] @ T[:3, :3].T + T[:3, 3], places[1], atol=1e-9)


def test_a_profile_names_the_file(cli: Cli, fitted: Path) -> None:
    """A profile beside the file names it, and `info` needs no transforms of the log any more."""
    text = (REPOSITORY / "svmdist" / "profiles" / "psm13.toml").read_text("utf-8")
    mine = fitted.parent / "mine.toml"
    mine.write_text(f'hand_eye = "{fitted.name}"\n' + text, "utf-8")
    profile = load_profile(mine)
    assert profile.camera_to_base is not None
    assert profile.for_instrument("PSM2").camera_to_base is None
    tf = open_recording(LOG, profile).transform_track("camera", "base")
    np.testing.assert_allclose(tf.T_parent_child[0], profile.camera_to_base.T_camera_base)
    assert cli("info", LOG, "--profile", mine).code == 0


def test_table_and_formats(cli: Cli, tmp_path: Path) -> None:
    """The command prints the transform, its deviations and how far the log's own is off; the file is not replaced."""
    path = tmp_path / "he.toml"
    outcome = cli("hand-eye", LOG, "--method", "fiducial", "-o", path)
    assert outcome.code == 0, outcome.err
    assert "PSM1: base in camera, by fiducial against kinematics" in outcome.out
    assert "the log's transform" in outcome.out
    assert 'hand_eye = "he.toml"' in outcome.err
    again = cli("hand-eye", LOG, "--method", "fiducial", "-o", path)
    assert again.code == 2
    assert "exists already" in again.err


def test_wrong_files(cli: Cli, fitted: Path, tmp_path: Path) -> None:
    """A file of other frames, one that is broken and one that is missing are one line each."""
    text = fitted.read_text("utf-8")
    cases = {
        'base = "PSM9_base"': (
            'base = "base"',
            "it is for base PSM9_base of PSM1; [frames] base is base: fit it anew",
        ),
        'instrument = "PSM7"': ('instrument = "PSM1"', "it is for PSM7; the profile has PSM1, PSM2"),
        "formt =": ("format =", "unknown key formt"),
        "translation_m = [[": ("translation_m = [", "not a TOML file"),
    }
    for new, (old, said) in cases.items():
        path = tmp_path / "other.toml"
        path.write_text(text.replace(old, new), "utf-8")
        outcome = cli("estimate", LOG, "--method", "fused", "--hand-eye", path)
        assert (outcome.code, outcome.out) == (1, ""), outcome.err
        assert len(outcome.err.strip().splitlines()) == 1
        assert said in outcome.err
    missing = cli("fk", LOG, "--hand-eye", tmp_path / "none.toml")
    assert missing.code == 1
    assert "none.toml: cannot read" in missing.err


def test_what_cannot_be_told(cli: Cli) -> None:
    """A log in which the tool hardly moves, and one without joints and poses, say so."""
    small = cli("hand-eye", REPOSITORY / "recordings" / "3d" / "contact.mcap", "--method", "fiducial")
    assert (small.code, small.out) == (1, "")
    assert "move the tool further" in small.err
    wrong = cli("hand-eye", LOG, "--method", "fused")
    assert wrong.code == 2
    assert "fused: the choices are: fiducial, shaft, stereo" in wrong.err
