"""Logs behind URLs: the same samples as from a disk, by the index where there is one, and one line where it fails."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import fsspec
import pytest
from fsspec.spec import AbstractBufferedFile, AbstractFileSystem

from svmdist.errors import RecordingError
from svmdist.files import RemoteFile
from svmdist.profile import Limits, load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from tests.recording.builders import rewrite
from tests.synthetic import make_scene, write_log

PROFILE = load_profile()
FETCHED: dict[str, int] = {}
HARM: dict[str, str] = {}


class CountedFile(AbstractBufferedFile):
    """Counts the bytes that are fetched of a local file; may fail, or give too little."""

    def _fetch_range(self, start: int, end: int) -> bytes:
        harm = HARM.get(self.path)
        if harm == "gone":
            raise RuntimeError("the store\nis gone")
        with open(self.path, "rb") as file:
            file.seek(start)
            data = file.read(end - start)
        FETCHED[self.path] = FETCHED.get(self.path, 0) + len(data)
        return data[: len(data) // 2] if harm == "short" else data


class CountedFiles(AbstractFileSystem):
    """Local files, opened as `CountedFile`."""

    protocol = "counted"
    root_marker = "/"

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Size of a file."""
        path = self._strip_protocol(path)
        return {"name": path, "size": Path(path).stat().st_size, "type": "file"}

    def _open(self, path: str, mode: str = "rb", **options: Any) -> CountedFile:
        return CountedFile(self, path, mode, **options)


@pytest.fixture(autouse=True)
def counted() -> Iterator[None]:
    fsspec.register_implementation("counted", CountedFiles, clobber=True)
    FETCHED.clear()
    HARM.clear()
    yield
    HARM.clear()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """1.4 MB: images of 640x480, joints, transforms and truth, in chunks of at most 256 KiB."""
    return write_log(tmp_path / "log.mcap", make_scene(), 40)


def small_chunks(log: Path, tmp_path: Path) -> Path:
    return rewrite(log, tmp_path / "small.mcap", "zstd")


def everything(source: McapSource, topics: set[str] | None = None) -> list[object]:
    return [
        (raw.topic, raw.schema, raw.message_encoding, raw.log_time_ns, bytes(raw.data), raw.offset)
        for raw in source.messages(topics)
    ]


def test_a_name_shows_no_secrets() -> None:
    file = RemoteFile("https://me:secret@host/day/a.mcap?token=secret")
    assert (str(file), file.name, file.stem, file.folders) == (
        "https://host/day/a.mcap",
        "a.mcap",
        "a",
        ("me:secret@host", "day"),
    )


@pytest.mark.parametrize("chunks", ["large", "small"])
def test_the_index_gives_what_the_whole_file_gives(log: Path, tmp_path: Path, chunks: str) -> None:
    path = log if chunks == "large" else small_chunks(log, tmp_path)
    near, far = McapSource(path, Limits()), McapSource(RemoteFile(f"counted://{path}"), Limits())
    assert far.topics() == near.topics()
    assert far.metadata() == near.metadata()
    joints, image = PROFILE.topics.joints, PROFILE.topics.image
    for topics in (None, {joints}, {image}, {joints, image}, {"/none"}):
        assert everything(far, topics) == everything(near, topics)
    assert near.health.is_clean
    assert far.health.is_clean


def test_only_what_is_asked_for_is_fetched(log: Path) -> None:
    """Of a log whose images stand in chunks of their own: its joints, without the images."""
    path = log.with_name("apart.mcap")
    write_apart(log, path)
    source = McapSource(RemoteFile(f"counted://{path}"), Limits())
    assert sum(1 for _ in source.messages({PROFILE.topics.joints})) == 401
    fetched, size = FETCHED[str(path)], path.stat().st_size
    assert 0 < fetched < size / 3, (fetched, size)


def write_apart(log: Path, path: Path) -> None:
    """The same messages, images eight times, with all of one topic behind all of another, in chunks of one each."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    with log.open("rb") as stream, path.open("wb") as output:
        writer = Writer(output, chunk_size=64 << 10, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start()
        reader = make_reader(stream)
        channels: dict[int, int] = {}
        messages = sorted(reader.iter_messages(), key=lambda found: found[1].topic)
        last = ""
        for schema, channel, message in messages:
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            if channel.topic != last:
                writer.flush()
                last = channel.topic
            for _ in range(8 if channel.topic == PROFILE.topics.image else 1):
                writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


def test_a_chunk_that_is_damaged_is_a_loss(log: Path) -> None:
    """As it is on a disk, at the same place."""
    summary = McapSource(log, Limits()).summary
    assert summary is not None
    chunk = summary.chunk_indexes[1]
    data = bytearray(log.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    log.write_bytes(data)
    near, far = McapSource(log, Limits()), McapSource(RemoteFile(f"counted://{log}"), Limits())
    assert everything(far) == everything(near)
    dropped = [loss for loss in near.health.losses if str(loss.kind) == "chunk"]
    assert dropped
    assert [loss for loss in far.health.losses if str(loss.kind) == "chunk"] == dropped
    assert any(str(loss.kind) == "statistics" for loss in far.health.losses)


@pytest.mark.parametrize(("harm", "said"), [("gone", "the store is gone"), ("short", "bytes came of")])
def test_a_store_that_fails_is_one_line(log: Path, harm: str, said: str) -> None:
    HARM[str(log)] = harm
    with pytest.raises(RecordingError, match=f"cannot read: .*{said}") as raised:
        open_recording(f"counted://{log}", PROFILE)
    assert "\n" not in str(raised.value)


class Quiet(SimpleHTTPRequestHandler):
    """Serves files whole, without ranges."""

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


def test_a_server_without_ranges_gives_the_file_whole(log: Path) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(log.parent))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/log.mcap"
        assert everything(McapSource(RemoteFile(url), Limits())) == everything(McapSource(log, Limits()))
        with pytest.raises(RecordingError, match="no such file"):
            open_recording(f"http://127.0.0.1:{server.server_port}/none.mcap", PROFILE)
        server.shutdown()


def test_flipped_bits_give_no_wrong_value_and_no_silent_loss(log: Path, tmp_path: Path) -> None:
    """Read by the index: a message that comes is one that was written, and one that does not is told."""
    check_flips(small_chunks(log, tmp_path), 150)


@pytest.mark.fault
def test_many_flipped_bits_give_no_wrong_value_and_no_silent_loss(log: Path, tmp_path: Path) -> None:
    check_flips(small_chunks(log, tmp_path), 4000)


def check_flips(path: Path, count: int) -> None:
    import random

    rng = random.Random(count)
    data = path.read_bytes()
    topics = {PROFILE.topics.joints}
    intact = everything(McapSource(path, Limits()), topics)
    memory = fsspec.filesystem("memory")
    found_less = 0
    for _ in range(count):
        flipped = bytearray(data)
        flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
        memory.pipe_file("/flipped.mcap", bytes(flipped))
        source = McapSource(RemoteFile("memory://flipped.mcap"), Limits())
        try:
            found = everything(source, topics)
        except RecordingError:
            found_less += 1
            continue
        left = iter(intact)
        assert all(any(one == other for other in left) for one in found), "a message that nobody wrote"
        if len(found) < len(intact):
            found_less += 1
            assert not source.health.is_clean, "messages are missing, and nothing says so"
    assert 0 < found_less < count
