"""The tally: what was read against what the end of the file declares."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable

import pytest
from mcap.records import Statistics

from svmdist.profile import Limits
from svmdist.recording.mcap_file.definitions import Definitions
from svmdist.recording.mcap_file.record_parsers import ChannelBody, SchemaBody
from svmdist.recording.mcap_file.summary import Summary
from svmdist.recording.mcap_file.tally import Tally

SCHEMA, CHANNEL = SchemaBody(1, "foxglove.JointStates", "protobuf", b""), ChannelBody(1, 1, "/js", "protobuf")


def tally() -> Tally:
    """Three messages of two channels, in two chunks."""
    made = Tally(chunk_count=2, chunk_offset_sum=30, attachment_count=1, metadata_count=1)
    for channel_id, log_time_ns in ((1, 50), (2, 40), (1, 60)):
        made.add_message(channel_id, log_time_ns)
    return made


def definitions() -> Definitions:
    """The schema and the channel that were read."""
    made = Definitions(Limits())
    made.complete({1: SCHEMA}, {1: CHANNEL})
    return made


def summary() -> Summary:
    """A summary that agrees."""
    statistics = Statistics(
        attachment_count=1,
        channel_count=2,
        channel_message_counts={1: 2, 2: 1, 9: 0},
        chunk_count=2,
        message_count=3,
        message_end_time=60,
        message_start_time=40,
        metadata_count=1,
        schema_count=1,
    )
    return Summary({1: SCHEMA}, {1: CHANNEL}, array("Q", [10, 20]), statistics)


def test_messages_are_counted_by_channel_and_their_times_span_the_pass() -> None:
    """Log times need not be in order."""
    made = tally()
    assert made.message_count == 3
    assert made.messages_by_channel == {1: 2, 2: 1}
    assert (made.start_ns, made.end_ns) == (40, 60)
    only = Tally()
    only.add_message(1, 7)
    assert (only.start_ns, only.end_ns) == (7, 7)


def test_a_summary_that_agrees_gives_no_word() -> None:
    """Channels without messages may be declared; a summary that says nothing contradicts nothing."""
    assert list(tally().disagreements(summary(), definitions())) == []
    assert list(tally().disagreements(Summary(), definitions())) == []
    assert list(Tally().disagreements(Summary(), Definitions(Limits()))) == []


def declare(**values: object) -> Callable[[Summary], None]:
    """Let the statistics declare something else."""

    def change(changed: Summary) -> None:
        for name, value in values.items():
            setattr(changed.statistics, name, value)

    return change


CHANGES: dict[str, tuple[Callable[[Summary], None], str]] = {
    "messages": (declare(message_count=4), "the statistics declare 4 messages, 3 were read"),
    "chunks": (declare(chunk_count=1), "the statistics declare 1 chunks, 2 were read"),
    "attachments": (declare(attachment_count=0), "the statistics declare 0 attachments, 1 were read"),
    "metadata": (declare(metadata_count=5), "the statistics declare 5 metadata records, 1 were read"),
    "channels": (declare(channel_message_counts={1: 1, 2: 2}), "other counts of messages by channel"),
    "times": (declare(message_start_time=39), r"declare log times \(39, 60\), found \(40, 60\)"),
    "channel": (
        lambda changed: changed.channels.update({1: ChannelBody(1, 1, "/other", "")}),
        "channel 1 is another one in the summary",
    ),
    "schema": (
        lambda changed: changed.schemas.update({1: SchemaBody(1, "other", "", b"")}),
        "schema 1 is another one in the summary",
    ),
    "index": (lambda changed: changed.chunk_offsets.append(5), "the index names 3 chunks, 2 were read"),
    "offsets": (
        lambda changed: changed.chunk_offsets.__setitem__(0, 11),
        "the index names 2 chunks, 2 were read, or others",
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_each_contradiction_is_told_once(what: str) -> None:
    change, words = CHANGES[what]
    changed = summary()
    change(changed)
    (told,) = tally().disagreements(changed, definitions())
    assert re.search(words, told)
