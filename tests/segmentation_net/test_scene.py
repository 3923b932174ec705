"""The pictures that the segmentation network is trained on: the same of the same seed, and labels that are exact."""

from __future__ import annotations

import numpy as np
import pytest

from training.camera import BORDERS, film, picture_area
from training.instruments import (
    DISTAL,
    OTHER,
    SHAFT,
    TISSUE,
    Part,
    draw,
    instrument,
    silhouette,
)
from training.materials import Material
from training.scene import HEIGHT, WIDTH, layers, render

SIZE = (150, 200)
WHITE = Material(np.full(3, 255.0, np.float32), np.ones(4), np.ones(3), 1.0, (), (1.0, 0.5, 0.0))
"""Lit alike everywhere: what is drawn in it shows how much of each pixel it covers."""


def test_the_same_seed_gives_the_same_picture() -> None:
    first, again, other = render(7), render(7), render(8)
    assert first[0].shape == (HEIGHT, WIDTH, 3)
    assert first[1].shape == (HEIGHT, WIDTH)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert (first[0] != other[0]).any()


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 2.5])
def test_a_part_is_labelled_where_it_covers_half_of_a_pixel(angle: float) -> None:
    """Against its outline's geometry: centres inside are labelled, and none farther out than rounding allows."""
    middle, along = np.array([100.3, 74.8]), np.array([np.cos(angle), np.sin(angle)])
    part = Part(middle - 50 * along, middle + 40 * along, 12.0, 8.0, SHAFT, WHITE)
    canvas, labels = np.zeros((*SIZE, 3), np.float32), np.full(SIZE, TISSUE, np.uint8)
    draw(canvas, labels, [part])
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    offset = np.stack([x, y], -1) - part.begin
    t = offset @ along / 90.0
    # Distance inwards from the nearest of the four sides, in px.
    to_side = 12.0 - 4.0 * t - np.abs(offset @ np.array([-along[1], along[0]]))
    to_end = 90.0 * np.minimum(t, 1.0 - t)
    labelled = labels == SHAFT
    corner = (np.abs(to_side) < 0.5) & (np.abs(to_end) < 0.5)  # less than half is covered there
    assert corner.sum() <= 8
    inwards = np.minimum(to_side, to_end)
    assert labelled[(inwards > 0.01) & ~corner].all()
    assert not labelled[inwards < -0.01].any()
    np.testing.assert_array_equal(canvas[..., 0] >= 127.5, labelled)
    area = 90.0 * (12.0 + 8.0)
    assert labelled.sum() == pytest.approx(area, rel=0.01)
    assert canvas[..., 0].sum() / 255.0 == pytest.approx(area, rel=0.01)


def test_instruments_change_the_picture_where_they_are_labelled() -> None:
    """By `draw` alone: what is labelled has changed, and what has changed is labelled or next to it."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        canvas, labels = np.full((*SIZE, 3), (20.0, 250.0, 20.0), np.float32), np.full(SIZE, TISSUE, np.uint8)
        parts = instrument(rng, SIZE, np.array([40, 50, 150], np.float32))
        draw(canvas, labels, parts)
        changed = (canvas != (20.0, 250.0, 20.0)).any(-1)
        inside = labels >= DISTAL
        assert changed[inside].all()
        grown = np.zeros_like(inside)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                grown |= np.roll(inside, (dy, dx), (0, 1))
        # Points of jaws that are thinner than a pixel cover less than half of those they touch.
        assert (changed & ~grown).sum() <= 0.01 * changed.sum() + 4
        # The shadow's outline is that of the instrument, but for whole pixels and rounded joints.
        drawn = silhouette(SIZE, parts) > 0
        assert (inside & ~drawn).sum() <= 0.2 * inside.sum() + 12


def test_instruments_come_in_from_the_border() -> None:
    """Shafts that are seen at all touch the edge of the image."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        canvas, labels = np.zeros((*SIZE, 3), np.float32), np.full(SIZE, TISSUE, np.uint8)
        draw(canvas, labels, instrument(rng, SIZE, np.array([40, 50, 150], np.float32)))
        shaft = labels == SHAFT
        edge = np.concatenate([shaft[0], shaft[-1], shaft[:, 0], shaft[:, -1]])
        assert edge.any() or not shaft.any() or (labels == DISTAL).any()


def test_without_instruments_nothing_is_labelled_so() -> None:
    for seed in range(20):
        made = layers(np.random.default_rng(seed), SIZE, count=0)
        assert made.labels.max() <= TISSUE


def test_a_picture_has_all_classes_in_turn() -> None:
    """Over forty pictures: every class, and pictures without instruments too."""
    labels = [render(seed)[1] for seed in range(40)]
    assert {int(c) for each in labels for c in np.unique(each)} == {OTHER, TISSUE, DISTAL, SHAFT}
    with_instruments = [bool((each >= DISTAL).any()) for each in labels]
    assert 0.6 <= np.mean(with_instruments) < 1.0
    assert 0.02 <= np.mean([(each >= DISTAL).mean() for each in labels]) <= 0.4


@pytest.mark.parametrize("border", BORDERS)
def test_a_border_is_black_and_of_no_class(border: str) -> None:
    """Outside of the picture's area the image is dark, beyond what optics and coding blur."""
    parts = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        picture = picture_area(rng, SIZE, border)
        assert (picture > 0).mean() >= 0.4
        assert border != "none" or (picture > 0).all()
        image = film(rng, np.full((*SIZE, 3), 220.0, np.float32), picture)
        outside = picture == 0
        for _ in range(9):  # motion blur and interlacing reach a few pixels beyond
            outside[1:-1, 1:-1] &= (
                outside[:-2, 1:-1] & outside[2:, 1:-1] & outside[1:-1, :-2] & outside[1:-1, 2:]
            )
        if outside.any():
            assert np.median(image[outside]) <= 40
        assert np.median(image[picture > 0]) >= 190
        parts.append((picture > 0).mean())
    assert (np.mean(parts) < 0.97) == (border != "none")


def test_labels_outside_of_the_picture_are_other() -> None:
    """By the picture as it is rendered: what is black at the corners of round and octagonal ones is no tissue."""
    seen = 0
    for seed in range(60):
        image, labels = render(seed)
        corners = [(0, 0), (0, -1), (-1, 0), (-1, -1)]
        if all(labels[corner] == OTHER for corner in corners) and max(image[c].max() for c in corners) < 40:
            seen += 1
            assert (labels == OTHER).mean() > 0.01
    assert seen >= 6  # of 60, a third have such a border
