"""The offset between the rows of both views, on drawn textures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.stereo import agreed_offset, row_differences


def views(rows_px: float, contrast: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A soft texture, and the same 25 px to the left and some rows lower, each with noise of its own."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (280, 420)), (0, 0), 3.0)
    texture = 120.0 + contrast * texture / texture.std()
    moved = np.array([[1.0, 0.0, -25.0], [0.0, 1.0, rows_px]])
    right = cv2.warpAffine(texture, moved, (420, 280), None, cv2.INTER_CUBIC, cv2.BORDER_REFLECT)
    return tuple(  # type: ignore[return-value]
        np.clip(view + rng.normal(0.0, 2.0, view.shape), 0, 255).astype(np.uint8) for view in (texture, right)
    )


@pytest.mark.parametrize("rows_px", [-3.4, 0.0, 1.5, 5.0])
def test_the_offset_is_found(rows_px: float) -> None:
    """To a tenth of a pixel, and within what is stated of it."""
    found = agreed_offset(row_differences(*views(rows_px, 20.0), 5.0, 60.0))
    assert found is not None
    assert found.px == pytest.approx(rows_px, abs=0.1)
    assert abs(found.px - rows_px) < 3.0 * found.std_px


def test_views_that_show_nothing_tell_none() -> None:
    """Plain views have no points, and points of different textures do not agree."""
    plain = np.full((280, 420), 120, np.uint8)
    assert agreed_offset(row_differences(plain, plain, 5.0, 60.0)) is None
    one, other = views(0.0, 20.0, seed=1)[0], views(0.0, 20.0, seed=2)[1]
    assert agreed_offset(row_differences(one, other, 5.0, 60.0)) is None


def test_mistaken_points_do_not_move_it() -> None:
    """A third of differences that mean nothing, spread over the whole range, moves it by less than it states."""
    rng = np.random.default_rng(3)
    differences = np.concatenate([rng.normal(1.5, 0.3, 200), rng.uniform(-8, 8, 100)])
    found = agreed_offset(differences)
    assert found is not None
    assert abs(found.px - 1.5) < 3.0 * found.std_px
