"""The fiducial plate: a detector reads the profile's tag off its texture, and the box has the plate's size."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.errors import SimulationError
from svmdist.profile import Profile
from svmdist.simulation.instrument import BLACK, CELL_PX, THICKNESS_M, WHITE, make_plate


def test_the_texture_is_the_tag(profile: Profile) -> None:
    fiducial = profile.fiducial
    assert fiducial is not None
    plate = make_plate(fiducial)
    assert set(np.unique(plate.texture)) == {BLACK, WHITE}
    family = getattr(cv2.aruco, f"DICT_APRILTAG_{fiducial.family}")
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(family))
    corners, ids, _ = detector.detectMarkers(cv2.resize(plate.texture, None, fx=0.5, fy=0.5))
    assert ids.ravel().tolist() == [fiducial.id]
    side_px = np.linalg.norm(corners[0][0, 1] - corners[0][0, 0])
    assert side_px == pytest.approx(
        plate.texture.shape[0] / 2 - CELL_PX, abs=2.0
    )  # less a margin of one cell


def test_the_box_has_the_plates_size(profile: Profile) -> None:
    fiducial = profile.fiducial
    assert fiducial is not None
    mesh = make_plate(fiducial).mesh
    size_m = np.ptp(mesh.vertices_m, axis=0)
    np.testing.assert_allclose(
        size_m, [fiducial.plate_side_m, fiducial.plate_side_m, THICKNESS_M], atol=1e-15
    )
    assert mesh.vertices_m[:, 2].max() == 0.0
    a, b, c = (mesh.vertices_m[mesh.faces[:, corner]] for corner in range(3))
    volume_m3 = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0  # positive: all faces look outside
    assert volume_m3 == pytest.approx(np.prod(size_m), rel=1e-9)


def test_a_tag_that_the_family_lacks_is_told(profile: Profile) -> None:
    assert profile.fiducial is not None
    with pytest.raises(SimulationError, match="its ids go from 0 to"):
        make_plate(profile.fiducial.model_copy(update={"id": 100_000}))
