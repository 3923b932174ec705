"""`svmdist hand-eye` on simulated logs whose own transform is off by centimetres, and what uses the result."""

from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import load_profile
from svmdist.profile.hand_eye import load_hand_eye
from svmdist.recording.log import open_recording
from svmdist.transforms import rotation_vector
from tests.conftest import REPOSITORY
from tests.shipped import PSM13

LOG = REPOSITORY / "recordings" / "real" / "random.mcap"
EXACT = REPOSITORY / "recordings" / "sweep.mcap"
"""A log of the same set-up whose transform is the true one."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hand-eye file of the log, by its tag."""
    from svmdist.profile.hand_eye import save_hand_eye
    from svmdist.report.info import hand_eye_file
    from svmdist.workflows.calibrate import hand_eye
    from svmdist.workflows.request import prepare

    setup = prepare("psm13", "fiducial")
    recording = open_recording(LOG, setup.profile)
    found = hand_eye(recording, setup, "PSM1")
    path = tmp_path_factory.mktemp("hand-eye") / "he.toml"
    save_hand_eye(path, hand_eye_file([found], recording))
    return path


def test_the_true_transform_is_in_the_stated_ellipsoid(fitted):
    """With joints that err by a degree and a log whose transform is centimetres off, 95 % holds the true one."""
    stated = load_hand_eye(fitted).of("PSM1")
    true = open_recording(EXACT, load_profile()).transform_track("camera", "base").T_parent_child[0]
    T = stated.T_camera_base
    error = np.concatenate([true[:3, 3] - T[:3, 3], rotation_vector(true[:3, :3] @ T[:3, :3].T)])
    assert error @ np.linalg.solve(np.array(stated.covariance), error) < 12.6


def test_methods_use_it(cli, fitted):
    """`kinematic` errs by millimetres in place of centimetres, and its interval still holds the truth."""
    errors = []
    command = (
        "validate",
        LOG,
        "--method",
        "kinematic",
        "--truth",
        "ground_truth",
        "--every",
        2,
        "-f",
        "json",
    )
    for options in ((), ("--hand-eye", fitted)):
        (score,) = cli(*command, *options).json["recordings"]
        errors.append(score["spatial_rmse_m"])
        assert score["spatial_interval_coverage"] >= 0.9
    assert errors[1] < 0.006
    assert errors[1] < 0.5 * errors[0]


def test_fk_in_the_camera(cli, fitted):
    """Poses in the camera's frame are the base's poses under the fitted transform."""
    stated = load_hand_eye(fitted).of("PSM1")
    rows = [cli("fk", LOG, *options).rows for options in ((), ("--in-camera", "--hand-eye", fitted))]
    assert len(rows[0]) == len(rows[1]) > 0
    places = [np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in part]) for part in rows]
    T = stated.T_camera_base
    np.testing.assert_allclose(places[0] @ T[:3, :3].T + T[:3, 3], places[1], atol=1e-9)


def test_a_profile_names_the_file(cli, fitted):
    """A profile beside the file names it, and `info` needs no transforms of the log any more."""
    mine = fitted.parent / "mine.toml"
    mine.write_text(f'hand_eye = "{fitted.name}"\n' + PSM13, "utf-8")
    profile = load_profile(mine)
    assert profile.for_instrument("PSM2").camera_to_base is None
    tf = open_recording(LOG, profile).transform_track("camera", "base")
    np.testing.assert_allclose(tf.T_parent_child[0], profile.camera_to_base.T_camera_base)
    cli("info", LOG, "--profile", mine)


def test_table_and_formats(cli, tmp_path):
    """The command prints the transform, its deviations and how far the log's own is off; the file is not replaced."""
    path = tmp_path / "he.toml"
    outcome = cli("hand-eye", LOG, "--method", "fiducial", "-o", path)
    assert "PSM1: base in camera, by fiducial against kinematics" in outcome.out
    assert "the log's transform" in outcome.out
    assert 'hand_eye = "he.toml"' in outcome.err
    assert "exists already" in cli("hand-eye", LOG, "--method", "fiducial", "-o", path, code=2).err


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'base = "base"',
            'base = "PSM9_base"',
            "it is for base PSM9_base of PSM1; [frames] base is base: fit",
        ),
        ('instrument = "PSM1"', 'instrument = "PSM7"', "it is for PSM7; the profile has PSM1, PSM2"),
        ("format =", "formt =", "unknown key formt"),
        ("translation_m = [", "translation_m = [[", "not a TOML file"),
    ],
)
def test_wrong_files(cli, fitted, tmp_path, old, new, said):
    """A file of other frames, and one that is broken, are one line."""
    path = tmp_path / "other.toml"
    path.write_text(fitted.read_text("utf-8").replace(old, new), "utf-8")
    outcome = cli("estimate", LOG, "--method", "fused", "--hand-eye", path, code=1)
    assert outcome.out == ""
    assert said in outcome.line
