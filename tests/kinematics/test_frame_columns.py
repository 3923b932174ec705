"""Very many joint vectors give what a few give."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.kinematics import dh
from svmdist.kinematics.dh import (
    CHUNK,
    Convention,
    DHChain,
    DHRow,
    forward_kinematics,
    frame_transforms,
    twist,
)
from svmdist.transforms import make_transform, rotation_x
from tests.shipped import CHAIN


def random_chain(convention: Convention) -> DHChain:
    """All kinds of joints, twists of a quarter turn and others, lengths that are zero and others."""
    rng = np.random.default_rng(3)
    kinds = ("fixed", "prismatic", "revolute", "fixed", "revolute", "prismatic", "revolute")
    twists_rad = (0.0, np.pi / 2, -np.pi / 2, 0.7, np.pi, -0.4, 0.0)
    rows = tuple(
        DHRow(f"j{index}", kind, rng.choice([0.0, 0.3]), alpha, *rng.choice([0.0, 0.2, -0.9], 2))  # type: ignore[arg-type]
        for index, (kind, alpha) in enumerate(zip(kinds, twists_rad, strict=True))
    )
    return DHChain(rows, convention, make_transform(rotation_x(0.7), [0.01, 0.02, 0.03]))


@pytest.mark.parametrize("chain", [random_chain("standard"), random_chain("modified"), CHAIN])
def test_columns_equal_products_of_matrices(chain: DHChain, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond one chunk, the tool agrees with the stacks of matrices within 1e-14."""
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (CHUNK + 200, len(chain.joint_names)))
    tools = forward_kinematics(chain, q)
    monkeypatch.setattr(dh, "MANY", len(q) + 1)
    np.testing.assert_allclose(tools, forward_kinematics(chain, q), atol=1e-14)


def test_the_leading_shape_is_kept() -> None:
    """A stack of stacks gives transforms of the same shape."""
    q = np.zeros((20, 30, 13))
    assert forward_kinematics(CHAIN, q).shape == (20, 30, 4, 4)
    assert frame_transforms(CHAIN, q).shape == (20, 30, 13, 4, 4)


def test_a_quarter_turn_is_exact() -> None:
    """Cosine and sine of a twist of π/2 are 0 and 1, those of other twists untouched."""
    assert twist(DHRow("j", "fixed", alpha_rad=np.pi / 2)) == (0.0, 1.0)
    assert twist(DHRow("j", "fixed", alpha_rad=0.3)) == (float(np.cos(0.3)), float(np.sin(0.3)))
