"""One frame is looked at once: conversions are counted, whatever the methods and however many instruments."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.estimation.association import Association
from svmdist.estimation.frame import Needs
from svmdist.estimation.methods import METHODS
from svmdist.estimation.scene import Arm, Scene
from svmdist.kinematics import robot_state
from svmdist.recording.log import open_recording
from svmdist.samples import Observation
from svmdist.vision import frame_context
from svmdist.workflows.replay import MultiInstrumentEstimator
from svmdist.workflows.request import Setup, prepare


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often colours of whole images are converted, exposures normalised, and joints selected."""
    counts: Counter[str] = Counter()
    convert, expose, select = cv2.cvtColor, frame_context.exposure_of, robot_state.select_joints

    def converted(image: np.ndarray, code: int, *rest: object) -> np.ndarray:
        if image.shape[:2] == (480, 640):
            counts[{cv2.COLOR_BGR2HSV: "HSV", cv2.COLOR_BGR2GRAY: "grey"}.get(code, "other")] += 1
        return convert(image, code, *rest)

    def exposed(*args: object) -> object:
        counts["exposure"] += 1
        return expose(*args)

    def selected(*args: object) -> object:
        counts["joints"] += 1
        return select(*args)

    monkeypatch.setattr(cv2, "cvtColor", converted)
    monkeypatch.setattr(frame_context, "exposure_of", exposed)
    monkeypatch.setattr(robot_state, "select_joints", selected)
    return counts


def measure_once(golden: Path, methods: tuple[str, ...]) -> tuple[Setup, int]:
    """Measure the second frame of the golden log of two instruments by some methods; gives their number too."""
    setups = [prepare(method=method) for method in methods]
    recording = open_recording(golden / "3d" / "duo.mcap", setups[0].profile)
    arms = [Arm(setups[0].profile.for_instrument(name)) for name in recording.instruments]
    association = Association(arms)
    lanes = [MultiInstrumentEstimator(setup, arms) for setup in setups]
    found = next(iter(recording.observations_of(recording.instruments)))
    assert isinstance(found, tuple)
    frames = association.frames(Scene(found[0], setups[0].profile, setups[0].segmenter), found)
    for lane in lanes:
        lane.estimate(frames)
    return setups[0], len(arms)


@pytest.mark.parametrize("methods", [("fused",), METHODS], ids=["fused", "all methods"])
def test_a_frame_is_converted_once(golden: Path, counted: Counter[str], methods: tuple[str, ...]) -> None:
    """Two images and two arms: one HSV and one exposure an image, at most one grey; joints once an arm."""
    _, arm_count = measure_once(golden, methods)
    assert counted["HSV"] == 2
    assert counted["exposure"] == 2
    assert counted["grey"] <= 2
    assert counted["other"] == 0
    assert counted["joints"] == arm_count


def test_an_observation_has_no_field_for_truth() -> None:
    """No estimator can peek: neither an observation nor a frame's scene holds a distance or a true pose."""
    assert not {name for name in Observation.__slots__ if "truth" in name or "distance" in name}


def test_needs_of_several_methods_are_joined() -> None:
    first = Needs(scene=("tissue",), frame=("tag",), robot=False)
    second = Needs(scene=("tags", "tissue"), right_view=True)
    assert first | second == Needs(("tissue", "tags"), ("tag",), robot=True, right_view=True)
