"""Figures of logs: ranked by what went wrong, and pooled so that every frame counts the same."""

from __future__ import annotations

from svmdist.report.scores import LOG_KEYS, LogFigures, log_rows, pooled_log_figures, ranked

FINE = LogFigures("fine", statuses={"ok": 10}, group="a")
LOST = LogFigures("lost", statuses={"ok": 4, "no_tool": 5, "no_tissue": 1}, group="b")
DARK = LogFigures("dark", statuses={"no_tool": 7}, group="b")
CUT = LogFigures("cut", statuses={"ok": 3}, loss_count=2, group="a")
FAILED = LogFigures("failed", failure="no such file")
EMPTY = LogFigures("empty")


def test_what_went_wrong_most_is_first() -> None:
    """What failed, what was not measured at all, then by the share of frames lost, then by losses."""
    found = ranked([FINE, LOST, DARK, CUT, FAILED, EMPTY])
    assert [one.recording for one in found] == ["failed", "dark", "empty", "lost", "cut", "fine"]
    assert [one.state for one in found] == [
        "failed",
        "nothing measured",
        "nothing measured",
        "ok",
        "loss",
        "ok",
    ]
    assert LOST.worst == ("no_tool", 5)


def test_groups_and_all_count_every_frame_once() -> None:
    """In the order of the groups' names, then all; logs that failed are in no group."""
    together = pooled_log_figures([FINE, LOST, DARK, CUT, FAILED, EMPTY])
    assert [one.recording for one in together] == ["a", "b", "overall"]
    assert [one.frame_count for one in together] == [13, 17, 30]
    assert [one.measured_count for one in together] == [13, 4, 17]
    rows = log_rows(ranked([FINE, FAILED]), together)
    assert all(tuple(row) == LOG_KEYS for row in rows)
    assert [row["rank"] for row in rows] == [1, 2, None, None, None]
    assert rows[0]["coverage"] is None
    assert rows[-1]["reason"] == "1 of 6 logs failed"
