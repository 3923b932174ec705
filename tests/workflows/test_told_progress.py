"""Steps of work are counted over all passes, and told with their total where that is known."""

from __future__ import annotations

from pathlib import Path

from svmdist.profile import load_profile
from svmdist.recording.log import Reading, Window, open_recording
from svmdist.workflows.progress import Steps, image_total


def test_steps_go_on_from_one_pass_to_the_next() -> None:
    told: list[tuple[int, int | None]] = []
    steps = Steps(lambda done, total: told.append((done, total)), 4)
    assert list(steps.of("ab")) == ["a", "b"]
    steps.advance()
    assert list(steps.of("c")) == ["c"]
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_nobody_need_listen() -> None:
    assert list(Steps(None, None).of([1, 2])) == [1, 2]


def test_the_total_is_known_where_it_is_known_of_every_log(golden: Path) -> None:
    recording = open_recording(golden / "sweep.mcap", load_profile())
    assert image_total([recording, recording]) == 160
    assert image_total([recording], lambda one: 3 * len(one.instruments)) == 240
    fewer = recording.read_as(Reading(window=Window(every=3)))
    assert image_total([recording, fewer]) == 80 + 27
    assert image_total([recording, recording.read_as(Reading(window=Window(1.0)))]) is None
