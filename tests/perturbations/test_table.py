"""The table and the choice from it: text round trips, real worlds follow their laws, profiles state deviations."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.generated_pages import DOCS
from svmdist.errors import UsageError
from svmdist.perturbations import (
    TABLE,
    UNPERTURBED,
    Perturbations,
    World,
    direction,
    draw_world,
    parse_perturbations,
)
from svmdist.profile import Profile, load_profile

SEEDS = range(1000)
REAL = [name for name, entry in TABLE.items() if entry.real is not None]


@st.composite
def choices(draw: st.DrawFn) -> Perturbations:
    names = draw(st.lists(st.sampled_from(sorted(TABLE)), unique=True, max_size=6))
    return Perturbations(tuple((name, draw(st.floats(TABLE[name].low, TABLE[name].high))) for name in names))


@given(choices())
def test_a_choice_reads_back_from_its_text(chosen):
    """Bit by bit: the metadata of a recording are enough to make it again."""
    assert (parse_perturbations(str(chosen)) if chosen else UNPERTURBED) == chosen


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
def test_what_cannot_be_is_told(text, said):
    with pytest.raises(UsageError, match=said):
        parse_perturbations(text)


def test_a_real_world_has_all_that_are_real_and_what_is_given():
    drawn = draw_world(World.REAL, 3)
    assert [name for name, _ in drawn.strengths] == REAL
    assert draw_world(World.REAL, 3) == drawn != draw_world(World.REAL, 4)
    other = draw_world(World.REAL, 3, parse_perturbations("lag=30,zoom=1.1"))
    assert dict(other.strengths) == dict(drawn.strengths) | {"lag": 30.0, "zoom": 1.1}


@pytest.mark.parametrize("name", REAL)
def test_real_strengths_follow_their_law(name):
    """Over 1,000 seeds: mean, spread and range; of several axes the deviation along each of them."""
    law = TABLE[name].real
    strengths = np.array([draw_world(World.REAL, seed)[name] for seed in SEEDS])
    assert TABLE[name].low <= strengths.min() <= strengths.max() <= TABLE[name].high
    if law.uniform is not None:
        low, high = law.uniform
        assert low <= strengths.min() <= strengths.max() <= high
        assert strengths.mean() == pytest.approx((low + high) / 2.0, abs=0.05 * (high - low) + 1e-9)
        return
    along = strengths[:, None]
    if law.axes > 1:
        along = along * [direction(seed, name, law.axes) for seed in SEEDS]
    np.testing.assert_allclose(along.std(axis=0), law.std, rtol=0.08)
    np.testing.assert_allclose(along.mean(axis=0), 0.0, atol=0.12 * law.std)
    assert np.abs(strengths).max() <= law.limit


def stated(profile: Profile) -> dict[str, float]:
    """The deviations that a profile states, in the units of the table."""
    camera, robot = profile.camera_error, profile.kinematic_error
    instrument, tag, tissue = profile.instrument, profile.fiducial, profile.tissue
    right_deg = float(np.degrees(camera.right_rotation_std_rad))
    return {
        "focal": 100.0 * camera.focal_std_fraction,
        "principal_point": camera.centre_std_px,
        "baseline": 1e3 * camera.baseline_std_fraction * profile.simulation.stereo_baseline_m,
        **dict.fromkeys(("right_yaw", "right_pitch", "right_roll"), right_deg),
        "plane": 1e3 * tissue.plane_distance_std_m,
        "plane_tilt": float(np.degrees(tissue.plane_tilt_std_rad)),
        "shaft_radius": 100.0 * instrument.shaft_radius_std_fraction,
        "knuckle_radius": 100.0 * instrument.knuckle_radius_std_fraction,
        "wrist_length": 1e3 * robot.length_std_m,
        "tag_size": 100.0 * tag.size_std_fraction,
        "tag_mount": 1e3 * tag.position_std_m,
        "lag": 1e3 * robot.time_offset_std_s,
    }


@pytest.mark.parametrize("name", sorted(stated(load_profile())))
def test_a_stated_deviation_is_that_of_real_worlds(name):
    """At least as large, at most three times."""
    law = TABLE[name].real
    assert law.uniform is None
    assert 0.999 * law.std <= stated(load_profile())[name] <= 3.0 * law.std


def test_every_source_is_in_the_list_of_sources():
    page = (DOCS / "simulation.md").read_text("utf-8")
    listed = page.partition("### Sources\n")[2].partition("\n## ")[0].replace("\n  ", " ")
    for entry in TABLE.values():
        for author, year in re.findall(r"([A-Z][a-z]+)(?: et al\.)? (\d{4})", entry.source):
            assert re.search(rf"{author}.*\b{year}", listed), entry.source
