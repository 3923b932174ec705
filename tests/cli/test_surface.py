"""`svmdist surface`: the tissue by both views, as files that other programs read."""

import numpy as np
import pytest
import trimesh

import svmdist
from benchmarks.log_changes import baseline, opened

FRAME = 20


def read_ply(path) -> np.ndarray:
    """Vertices with all their properties, as trimesh reads them."""
    return trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]


@pytest.fixture(scope="module")
def surface(golden):
    return svmdist.surface(svmdist.open_recording(golden / "3d" / "contact.mcap"), FRAME)


def test_the_files_hold_what_python_gives(golden, cli, tmp_path, surface):
    """Points, normals, deviations and colours; the command says how much of the tissue that is."""
    for ending in ("ply", "npz", "csv"):
        path = tmp_path / f"tissue.{ending}"
        done = cli("surface", golden / "3d" / "contact.mcap", "--at", 0.1 * FRAME, "-o", path)
        assert f"frame {FRAME}: {len(surface.points_m)} points" in done.err
    ply, npz = read_ply(tmp_path / "tissue.ply"), np.load(tmp_path / "tissue.npz")
    points = np.stack([ply[axis] for axis in "xyz"], -1)
    assert points == pytest.approx(surface.points_m, abs=1e-6)
    assert np.stack([ply[f"n{axis}"] for axis in "xyz"], -1) == pytest.approx(surface.normals, abs=1e-6)
    assert npz["std_m"] == pytest.approx(surface.std_m)
    assert np.array_equal(np.stack([ply[name] for name in ("red", "green", "blue")], -1), surface.rgb)
    lines = (tmp_path / "tissue.csv").read_text("utf-8").splitlines()
    assert len(lines) == 1 + len(points)


def test_the_surface_lies_on_the_simulated_tissue(golden, surface):
    """Most of the tissue is there, as high over the true plane as the organ, and red; errors are as stated."""
    recording = svmdist.open_recording(golden / "3d" / "contact.mcap")
    frames = recording.origin.profile.frames
    track = recording.transform_track(frames.camera, frames.tissue, ground_truth=True)
    T = track.at(np.array([surface.stamp_ns]), 10**8).values[0]
    height_m = (surface.points_m - T[:3, 3]) @ T[:3, 2]
    assert surface.share > 0.6
    assert np.mean((height_m > -2.0 * surface.std_m) & (height_m < 0.0085 + 2.0 * surface.std_m)) > 0.95
    assert 0.006 < np.percentile(height_m, 90) < 0.0095
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    assert np.mean(surface.normals @ T[:3, 2] > 0.7) > 0.95
    assert np.all(np.median(surface.rgb[:, :1] - surface.rgb[:, 1:].astype(int), 0) > 40)


def test_a_baseline_in_millimetres_is_named(golden, cli, tmp_path):
    """Nothing could be seen so near: it is no surface, and no row, and both say what to look at."""
    case = opened(str(golden / "3d" / "contact.mcap"), "psm13", "two", tmp_path)
    baseline(1e3)(case)
    case.write(changed := tmp_path / "mm.mcap")
    done = cli("surface", changed, "-o", tmp_path / "tissue.ply", code=1)
    assert "disparities" in done.err
    assert "the baseline (unit, sign)" in done.err
    done = cli("estimate", changed, "--method", "stereo", "--every", 20, "-f", "csv", code=3)
    assert "the baseline (unit, sign)" in done.err
    assert ",ok," not in done.out
