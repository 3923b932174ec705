"""What people get wrong does not pass unnoticed: some of the bench of mistakes, on a golden log."""

import pytest

from benchmarks.mistakes import MISTAKES, verdicts
from tests.golden import RECORDINGS

LOG = str(RECORDINGS / "3d" / "contact.mcap")
SOME = (
    "plane 10 mm too near",
    "radius is halved",
    "tag -20 %",
    "DH modified",
    "views exchanged",
    "base: in mm",
)


@pytest.mark.slow
@pytest.mark.parametrize("part", SOME)
def test_a_mistake_is_refused_warned_of_or_covered(part: str) -> None:
    (mistake,) = (name for name in MISTAKES if part in name)
    found = verdicts(LOG, mistake, "psm13", ("stereo", "fused"), 4)
    assert found
    assert not [str(one) for one in found if one.verdict == "FAIL" or one.far]


@pytest.mark.slow
def test_nothing_is_said_to_contradict_where_all_is_right() -> None:
    found = verdicts(LOG, "nothing", "psm13", ("kinematic", "fiducial", "shaft", "stereo", "fused"), 4)
    assert {one.verdict for one in found} == {"covered"}
