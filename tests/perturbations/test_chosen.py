"""The table and the choice from it: what is read is what is written, and real worlds follow the stated deviations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svmdist.errors import UsageError
from svmdist.perturbations.chosen import (
    UNPERTURBED,
    Perturbations,
    World,
    direction,
    draw_world,
    parse_perturbations,
)
from svmdist.perturbations.table import (
    CALIBRATION,
    CLOCK,
    IMAGES,
    JOINTS,
    TABLE,
    Always,
    Normal,
    Place,
    Uniform,
    real_std,
)

SEEDS = range(1000)


@st.composite
def choices(draw: st.DrawFn) -> Perturbations:
    names = draw(st.lists(st.sampled_from(sorted(TABLE)), unique=True, max_size=6))
    return Perturbations(tuple((name, draw(st.floats(TABLE[name].low, TABLE[name].high))) for name in names))


@given(choices())
def test_a_choice_reads_back_from_its_text(chosen: Perturbations) -> None:
    """Bit by bit: the metadata of a recording are enough to make it again."""
    assert (parse_perturbations(str(chosen)) if chosen else UNPERTURBED) == chosen


def test_what_is_not_chosen_is_neutral() -> None:
    chosen = Perturbations((("focal", 1.0), ("lag", 0.0)))
    assert chosen["focal"] == 1.0
    assert chosen["baseline"] == 0.0
    assert chosen["zoom"] == 1.0
    assert chosen.has("focal", "lag")
    assert not chosen.has("lag", "zoom")
    assert chosen.changes(Place.CALIBRATION)
    assert not chosen.changes(Place.CLOCK)
    assert not any(UNPERTURBED.changes(place) for place in Place)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("focl=1", "did you mean focal"),
        ("focal", "NAME=STRENGTH"),
        ("focal=", "NAME=STRENGTH"),
        ("focal=one", "NAME=STRENGTH"),
        ("focal=nan", "from -20 to 20 %, found nan"),
        ("focal=21", "from -20 to 20 %, found 21"),
        ("backlash=-1", "from 0 to 10 deg"),
        ("focal=1,focal=2", "given twice"),
        ("", "no perturbation"),
    ],
)
def test_what_cannot_be_is_told(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        parse_perturbations(text)


def test_an_ideal_world_has_what_is_given_and_no_more() -> None:
    assert draw_world(World.IDEAL, 1) == UNPERTURBED
    lag = parse_perturbations("lag=30")
    assert draw_world(World.IDEAL, 1, lag) is lag


def test_a_real_world_has_all_that_are_real_and_what_is_given() -> None:
    drawn = draw_world(World.REAL, 3)
    assert [name for name, _ in drawn.strengths] == [
        n for n, entry in TABLE.items() if entry.real is not None
    ]
    assert draw_world(World.REAL, 3) == drawn != draw_world(World.REAL, 4)
    other = draw_world(World.REAL, 3, parse_perturbations("lag=30,zoom=1.1"))
    assert dict(other.strengths) == dict(drawn.strengths) | {"lag": 30.0, "zoom": 1.1}


@pytest.mark.parametrize("name", [name for name, entry in TABLE.items() if entry.real is not None])
def test_real_strengths_follow_their_law(name: str) -> None:
    """Over 1,000 seeds: mean, spread and range; of several axes the deviation along each of them."""
    law = TABLE[name].real
    strengths = np.array([draw_world(World.REAL, seed)[name] for seed in SEEDS])
    assert TABLE[name].low <= strengths.min() <= strengths.max() <= TABLE[name].high
    match law:
        case Always(strength):
            assert (strengths == strength).all()
        case Uniform(low, high):
            assert low <= strengths.min() < strengths.max() <= high
            assert strengths.mean() == pytest.approx((low + high) / 2.0, abs=0.05 * (high - low))
        case Normal(std, axes, limit):
            along = strengths[:, None]
            if axes > 1:
                along = along * [direction(seed, name, axes) for seed in SEEDS]
            np.testing.assert_allclose(along.std(axis=0), std, rtol=0.08)
            np.testing.assert_allclose(along.mean(axis=0), 0.0, atol=0.12 * std)
            assert np.abs(strengths).max() <= limit
        case _:
            raise AssertionError(law)


def test_stated_deviations_are_told_for_normal_strengths_only() -> None:
    stated = {
        "focal": 0.3,
        "principal_point": 1.5,
        "baseline": 0.05,
        "right_yaw": 0.03,
        "plane": 1.0,
        "plane_tilt": 1.0,
    }
    stated |= {
        "shaft_radius": 2.0,
        "wrist_length": 0.3,
        "knuckle_radius": 3.0,
        "tag_size": 0.5,
        "tag_mount": 0.3,
    }
    assert {name: real_std(name) for name in stated} == stated
    assert real_std("lag") == 20.0
    with pytest.raises(ValueError, match="backlash"):
        real_std("backlash")


def test_names_are_drawn_apart_from_each_other() -> None:
    """No two of the normal ones go together."""
    names = [name for name, entry in TABLE.items() if isinstance(entry.real, Normal) and entry.real.axes == 1]
    worlds = np.array([[draw_world(World.REAL, seed)[name] for name in names] for seed in SEEDS])
    correlation = np.corrcoef(worlds.T) - np.eye(len(names))
    assert np.abs(correlation).max() < 0.15


def test_the_table_is_all_of_its_parts_in_order() -> None:
    """No name is in two of them, and joints, clock and calibration stand where they say."""
    parts = (JOINTS, CLOCK, CALIBRATION, IMAGES)
    assert [entry.name for part in parts for entry in part] == list(TABLE)
    for part, place in zip(parts, (Place.JOINTS, Place.CLOCK, Place.CALIBRATION, Place.IMAGES), strict=True):
        assert {entry.place for entry in part} == {place}


def test_every_entry_can_be_told() -> None:
    for name, entry in TABLE.items():
        assert name == entry.name == name.lower()
        assert entry.low <= entry.neutral <= entry.high
        assert entry.meaning.endswith(".")
        assert bool(entry.source) == (entry.real is not None)
        assert entry.at_record or entry.at_replay
