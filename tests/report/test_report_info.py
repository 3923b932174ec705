"""A recording's summary: rows and document say the same, and names from a file cannot drive the terminal."""

from __future__ import annotations

import json
from pathlib import Path

from svmdist.profile import load_profile
from svmdist.recording.summary import inspect_recording
from svmdist.report.info import SCHEMA, TOPIC_KEYS, info_document, info_lines, topic_row


def test_the_document_counts_what_the_log_holds(synthetic_log: Path) -> None:
    """40 images, a camera of 320x240 or larger, all losses none; and JSON can hold it."""
    profile = load_profile()
    summary = inspect_recording(synthetic_log, profile)
    document = json.loads(json.dumps(info_document(summary, profile), allow_nan=False))
    assert (document["schema"], document["is_clean"], document["losses"]) == (SCHEMA, True, [])
    topics = {topic["topic"]: topic for topic in document["topics"]}
    assert topics[document["roles"]["image"]]["message_count"] == 40
    assert all(tuple(topic_row(topic)) == TOPIC_KEYS for topic in summary.topics)
    assert document["methods"]["overlay"] == {"served": True, "missing": []}


def test_lines_tell_the_same(synthetic_log: Path) -> None:
    """Every topic, the methods that the log serves, and that nothing was lost."""
    profile = load_profile()
    summary = inspect_recording(synthetic_log, profile)
    text = "".join(info_lines(summary, profile))
    assert all(topic.topic in text for topic in summary.topics)
    assert "health      clean" in text
    assert "overlay" in text.split("methods ")[1].splitlines()[0]
