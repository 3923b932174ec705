"""Views of a recording can be sent to other processes, and few passes over the file serve them all."""

import pickle
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from svmdist.perturbations import Perturbations
from svmdist.profile import load_profile
from svmdist.recording import mcap
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.observations import Window
from svmdist.tracks import LagEstimate
from svmdist.workflows.request import Request, prepare
from svmdist.workflows.validate import validate
from tests.reading import read_observations
from tests.synthetic import make_scene, write_log

VIEWS = {
    "as opened": lambda log: log,
    "perturbed": lambda log: log.perturbed(Perturbations((("backlash", 0.5), ("lag", 20.0)))),
    "clock": lambda log: replace(log, lag=LagEstimate(0.02, 0.0, 1.0)),
    "instrument": lambda log: log.for_instrument(log.instruments[0]),
    "window": lambda log: replace(log, alias="other", window=Window(0.05, 0.2, 2)),
}


@pytest.mark.parametrize("view", VIEWS)
def test_a_view_can_be_sent_to_another_process(tmp_path, view):
    """What comes out of it there is the same to the last bit."""
    path = write_log(tmp_path / "a.mcap", make_scene(64, 48), 12)
    mine: Recording = VIEWS[view](open_recording(path, load_profile()))
    theirs = pickle.loads(pickle.dumps(mine))
    assert (theirs.name, theirs.lag, theirs.world.seed) == (mine.name, mine.lag, mine.world.seed)
    assert theirs.origin == mine.origin
    np.testing.assert_array_equal(theirs.joint_track().positions, mine.joint_track().positions)
    for one, two in zip(read_observations(mine), read_observations(theirs), strict=True):
        assert repr((two.stamp_ns, two.joints)) == repr((one.stamp_ns, one.joints))


def test_validate_reads_a_log_once(tmp_path, monkeypatch):
    """With a planar method each chunk is expanded once, but for the first one, in which the camera is."""
    expanded: Counter[int] = Counter()
    whole = mcap._expanded

    def counted(chunk: mcap.Chunk, *args: object, **options: bool) -> mcap.Chunk:
        expanded[chunk.message_start_time] += 1
        return whole(chunk, *args, **options)

    monkeypatch.setattr(mcap, "_expanded", counted)
    path = write_log(tmp_path / "a.mcap", make_scene(), 20)
    setup = prepare()
    validate([open_recording(path, setup.profile)], Request(setup), jobs=1)
    assert max(list(expanded.values())[1:]) == 1
