"""What commands say last: detections that were refused, and alarms."""

from dataclasses import replace

from svmdist.estimation.alarms import AlarmRules, AlarmWatch
from svmdist.results import Distance, Distances, FrameResult
from svmdist.samples import Status
from svmdist.workflows.estimate import Ending, alarms_in_words, refusals_in_words

RULES = AlarmRules(0.005, "likely")


def ending(clearances_m: list[float], refused: int = 0) -> Ending:
    """Rows of one log at 10 Hz, the first ones with a refused tag, and one that is not measured."""
    rows, watch = [], AlarmWatch(RULES)
    for at, clearance_m in enumerate(clearances_m):
        accepted, wrong = ("shaft", "disparity"), ("tag",)
        if at >= refused:
            accepted, wrong = (*accepted, *wrong), ()
        distances = Distances(clearance=Distance(clearance_m, 1e-3))
        row = FrameResult(at, Status.OK, distances=distances, instrument="PSM1", number=at, seconds=0.1 * at)
        rows.append(replace(row, accepted=accepted, refused=wrong, alarm=watch.watch(row)))
    return Ending.of([*rows, FrameResult(99, Status.NO_TISSUE, instrument="PSM1")])


def test_what_was_refused_and_what_it_contradicts():
    """By log and over logs; where nothing else was seen, the joints."""
    logs = [ending([0.02] * 4, refused=3), ending([0.02] * 4)]
    (said,) = refusals_in_words(logs)
    assert said == "tag refused in 3 of 8 frames: it contradicts shaft and disparity"
    alone = Ending(seen={"tag": 5}, refused={"tag": 4})
    assert list(refusals_in_words([alone])) == ["tag refused in 4 of 5 frames: it contradicts the joints"]
    assert list(refusals_in_words([logs[1]])) == []


def test_alarms_are_counted_and_named():
    """The first and the longest; with the log where there are several. No alarm is said, too."""
    far, near = ending([0.02, 0.03]), ending([0.02, 0.004, 0.02, 0.002, 0.001])
    rows = "frames without a clearance raise none, which does not make them safe"
    rule = "(clearance below 5 mm likely, P ≥ 0.5)"
    assert alarms_in_words({"a": far}, RULES) == f"no alarm {rule}; 1 {rows}"
    said = alarms_in_words({"a": far, "b": near}, RULES)
    assert said == (f"2 alarms {rule}: first at 0.10 s (b, frame 1), longest 0.10 s (b, frame 3); 2 {rows}")
    assert "first at 0.10 s (frame 1)" in alarms_in_words({"b": near}, RULES)
