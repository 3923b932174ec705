"""The databases of rosbag2: rows in their order, and nothing but plain tables is asked."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.rosbag.sqlite_source import SqliteSource
from svmdist.recording.source import LossKind

LIMITS = Limits()
SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES (1, '/js', 'sensor_msgs/msg/JointState', 'cdr'), (2, '/tf', 'tf2_msgs/msg/TFMessage', 'cdr');
"""
Row = tuple[object, object, object, object]
MESSAGES: list[Row] = [
    (number, 1 + number % 2, 1000 + number, bytes([number]) * number) for number in range(1, 8)
]


def write(path: Path, rows: Sequence[Row] = MESSAGES) -> Path:
    """A database with these rows of messages."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript(SCHEMA)
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        database.commit()
    return path


def delivered(source: SqliteSource, *topics: str) -> list[tuple[str, int, bytes]]:
    """What the source gives of all messages, or of those of some topics."""
    return [(raw.topic, raw.log_time_ns, bytes(raw.data)) for raw in source.messages(topics or None)]


def test_rows_are_messages_in_the_order_of_their_ids(tmp_path: Path) -> None:
    source = SqliteSource(write(tmp_path / "a b#?.db3", MESSAGES[::-1]), LIMITS)
    expected = [("/js" if topic == 1 else "/tf", time, data) for _, topic, time, data in MESSAGES]
    assert delivered(source) == expected
    assert delivered(source, "/tf") == [each for each in expected if each[0] == "/tf"]
    assert [(info.topic, info.message_count) for info in source.topics()] == [("/js", 3), ("/tf", 4)]
    assert source.health.is_clean
    assert source.metadata() == {}


def test_topics_without_messages_are_listed(tmp_path: Path) -> None:
    source = SqliteSource(write(tmp_path / "a.db3", []), LIMITS)
    assert [info.message_count for info in source.topics()] == [0, 0]
    assert delivered(source) == []


def test_a_row_that_is_missing_or_belongs_to_no_topic_is_a_loss(tmp_path: Path) -> None:
    """The others are delivered, with the losses before them."""
    rows = [MESSAGES[0], MESSAGES[2], (4, 9, 0, b""), MESSAGES[4]]
    source = SqliteSource(write(tmp_path / "a.db3", rows), LIMITS)
    assert [raw.losses_before for raw in source.messages()] == [0, 1, 2]
    details = [loss.detail for loss in source.health.losses]
    assert details == ["a.db3: message 3 follows message 1", "message 4 belongs to no topic"]


@pytest.mark.parametrize(
    ("time", "data"),
    [("soon", b""), (1.5, b""), (1, "text"), (1, None), (1, 7), (1, bytes(1025))],
    ids=["text time", "fraction", "text", "nothing", "number", "large"],
)
def test_a_row_of_another_kind_is_a_loss(tmp_path: Path, time: object, data: object) -> None:
    """SQLite stores any value in any column; a blob above the limit is never read."""
    rows = [MESSAGES[0], (2, 1, time, data), MESSAGES[2]]
    source = SqliteSource(write(tmp_path / "a.db3", rows), Limits(record_bytes=1024))
    assert [raw.log_time_ns for raw in source.messages()] == [MESSAGES[0][2], MESSAGES[2][2]]
    (loss,) = source.health.losses
    assert (loss.kind, loss.topic) == (LossKind.RECORD, "/js")
    assert "malformed or above the limit" in loss.detail


@pytest.mark.parametrize(
    "schema",
    [
        "CREATE TABLE other(id INTEGER);",
        "CREATE TABLE topics(id INTEGER); CREATE VIEW messages AS SELECT 1 AS id;",
        "CREATE VIEW topics AS SELECT 1 AS id; CREATE VIEW messages AS SELECT 1 AS id;",
    ],
    ids=["other", "one view", "two views"],
)
def test_a_database_without_the_plain_tables_is_refused(tmp_path: Path, schema: str) -> None:
    """A view could run anything, and for ever."""
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(schema)
    source = SqliteSource(path, LIMITS)
    with pytest.raises(RecordingError, match="an SQLite database, but not of rosbag2"):
        delivered(source)
    with pytest.raises(RecordingError, match="not of rosbag2"):
        source.topics()


def test_tables_without_the_columns_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript("CREATE TABLE topics(id INTEGER); CREATE TABLE messages(id INTEGER);")
    with pytest.raises(RecordingError, match="no usable rosbag2 database: no such column"):
        delivered(SqliteSource(path, LIMITS))


def test_a_truncated_file_is_refused_at_any_end(tmp_path: Path) -> None:
    """SQLite takes zeros for a missing part of the last page; here the header's count of pages decides."""
    data = write(tmp_path / "whole.db3").read_bytes()
    path = tmp_path / "a.db3"
    for end in (0, 50, 99, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:end])
        with pytest.raises(RecordingError, match=f"truncated at byte {end}"):
            SqliteSource(path, LIMITS)
    with pytest.raises(RecordingError, match="cannot read: No such file"):
        SqliteSource(tmp_path / "none.db3", LIMITS)


def test_what_an_interrupted_recorder_left_is_told(tmp_path: Path) -> None:
    """An empty journal holds nothing that could be missing."""
    path = write(tmp_path / "a.db3")
    path.with_name("a.db3-wal").write_bytes(b"")
    assert SqliteSource(path, LIMITS).health.is_clean
    path.with_name("a.db3-journal").write_bytes(b"left")
    (loss,) = SqliteSource(path, LIMITS).health.losses
    assert loss.kind is LossKind.STRUCTURE
    assert loss.detail.startswith("a.db3-journal was left by an interrupted recorder")


def test_the_file_is_not_changed(tmp_path: Path) -> None:
    """Nor is a journal made beside it."""
    path = write(tmp_path / "a.db3")
    before = path.read_bytes()
    delivered(SqliteSource(path, LIMITS))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def scripted(path: Path, script: str) -> SqliteSource:
    """The source of a database that a script makes."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript(script)
        database.commit()
    return SqliteSource(path, LIMITS)


@pytest.mark.parametrize(
    "ids", ["'1', 'two'", "x'0102', 7.5", "NULL, NULL"], ids=["text", "blobs and fractions", "nothing"]
)
def test_ids_that_are_no_numbers_are_losses(tmp_path: Path, ids: str) -> None:
    """SQLite keeps whatever it is given, unless the column is a key of whole numbers."""
    first, second = ids.split(", ")
    script = SCHEMA.replace("messages(id INTEGER PRIMARY KEY", "messages(id")
    script += f"INSERT INTO messages VALUES ({first}, 1, 5, x'00'), ({second}, 1, 6, x'01');"
    source = scripted(tmp_path / "a.db3", script)
    assert delivered(source) == []
    assert {loss.kind for loss in source.health.losses} == {LossKind.RECORD}


@pytest.mark.parametrize("value", ["'text'", "7", "NULL", "1.5"])
def test_data_and_times_of_another_type_are_losses(tmp_path: Path, value: str) -> None:
    script = SCHEMA + f"INSERT INTO messages VALUES (1, 1, 5, {value}), (2, 1, 6, x'01')"
    script += f", (3, 1, {'NULL' if value == '7' else value}, x'02');"
    source = scripted(tmp_path / "a.db3", script)
    assert delivered(source) == [("/js", 6, b"\x01")]
    assert not source.health.is_clean


@pytest.mark.parametrize("table", ["topics", "messages"])
def test_columns_that_are_computed_are_refused(tmp_path: Path, table: str) -> None:
    """A row of a few bytes could give two gigabytes."""
    column = {
        "messages": ("data BLOB)", "data BLOB AS (zeroblob(2000000000)))"),
        "topics": (
            "serialization_format TEXT)",
            "serialization_format TEXT, more BLOB AS (zeroblob(2000000000)))",
        ),
    }[table]
    script = SCHEMA[: SCHEMA.index("INSERT")].replace(*column)
    source = scripted(tmp_path / "a.db3", script)
    with pytest.raises(RecordingError, match="not of rosbag2"):
        delivered(source)
    with pytest.raises(RecordingError, match="not of rosbag2"):
        source.topics()


def test_topics_that_contradict_each_other(tmp_path: Path) -> None:
    """Two rows of one name, or of one id, give no message twice, and none of a type that is in doubt."""
    script = SCHEMA.replace("topics(id INTEGER PRIMARY KEY", "topics(id INTEGER")
    script += (
        "INSERT INTO topics VALUES (1, '/js', 'other/msg/Type', 'cdr'), (3, '/tf', 'other/msg/Type', 'cdr');"
    )
    script += "INSERT INTO messages VALUES (1, 1, 5, x'01'), (2, 2, 6, x'02'), (3, 3, 7, x'03');"
    source = scripted(tmp_path / "a.db3", script)
    assert delivered(source) == [("/tf", 6, b"\x02")]
    assert LossKind.DEFINITION in {loss.kind for loss in source.health.losses}


@pytest.mark.parametrize("name", ["x'ff'", "NULL", "CAST(x'ff' AS TEXT)", "printf('%.5000c', 'a')"])
def test_topics_without_a_name(tmp_path: Path, name: str) -> None:
    """What is no text, not UTF-8 or endless names nothing."""
    script = SCHEMA + f"UPDATE topics SET name = {name} WHERE id = 1;"
    script += "INSERT INTO messages VALUES (1, 1, 5, x'01'), (2, 2, 6, x'02');"
    source = scripted(tmp_path / "a.db3", script)
    assert delivered(source) == [("/tf", 6, b"\x02")]
    assert [info.topic for info in source.topics()] == ["/tf"]
    assert not source.health.is_clean


def test_a_row_that_takes_for_ever_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite's own steps are counted, not the time: a query that goes on without a row is broken off."""
    monkeypatch.setattr("svmdist.recording.rosbag.sqlite_source.MAX_STEPS", 1_000_000)
    source = SqliteSource(write(tmp_path / "a.db3"), LIMITS)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n WHERE i < 0"
    with pytest.raises(RecordingError, match="interrupted"):
        list(source._rows(endless))
