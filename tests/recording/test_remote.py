"""Logs behind URLs: the same samples as from a disk, by the index where there is one, and one line where it fails."""

import random
import re
import socket
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import fsspec
import pytest
from fsspec.spec import AbstractBufferedFile, AbstractFileSystem

from svmdist import remote
from svmdist.errors import RecordingError, concealed
from svmdist.profile import Limits
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from svmdist.remote import RemoteFile, without_secrets
from tests.recording.builders import rewrite, write_messages
from tests.recording.faults import flip_bit, is_subsequence
from tests.shipped import PROFILE
from tests.synthetic import make_scene, write_log

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


def everything(source: McapSource, topics: set[str] | None = None) -> list[object]:
    return [
        (raw.topic, raw.schema, raw.message_encoding, raw.log_time_ns, bytes(raw.data), raw.offset)
        for raw in source.messages(topics)
    ]


@pytest.mark.parametrize("user", ["me:secret@", "KEY:sec/ret@", "me:se@cret@", "me:secret@/@", "secret@"])
def test_a_name_shows_no_secrets(user):
    file = RemoteFile(f"https://{user}host/day/a.mcap?token=secret")
    assert (str(file), file.name, file.stem) == ("https://host/day/a.mcap", "a.mcap", "a")
    assert repr(file) == str(file)
    assert file.folders == ("host", "day")
    said = f"{user}host is no bucket, https:/{user}host/day no folder"
    assert str(RecordingError(without_secrets(said, file.url))) == "***@host is no bucket, https:/host/day no folder"
    plain = "http://host:80/me@home/a.mcap"
    assert concealed(plain) == plain


@pytest.mark.parametrize("url", ["http://[::1/a.mcap", "s3://[::1/a.mcap", "http://h:x/a.mcap", "http://]"])
def test_a_wrong_address_is_one_line(url):
    with pytest.raises(RecordingError, match=r"cannot read: (Invalid IPv6 URL|Port could not)"):
        open_recording(url, PROFILE)


def test_no_key_in_a_url_of_s3(cli):
    """Whatever shows it: errors, remarks, and what typer says itself."""
    url = "s3://KEY:SECRET@logs/a.mcap"
    for *arguments, code in (("info", url, 1), ("estimate", "-v", url, "x.mcap", 1), ("show", url, url, 2)):
        done = cli(*arguments, code=code)
        assert "logs/a.mcap" in done.err
        assert not {"KEY", "SECRET"} & set(re.split(r"\W", done.out + done.err)), done.err


@pytest.mark.parametrize("chunks", ["large", "small"])
def test_the_index_gives_what_the_whole_file_gives(log, tmp_path, chunks):
    path = log if chunks == "large" else rewrite(log, tmp_path / "small.mcap", "zstd")
    near, far = McapSource(path, Limits()), McapSource(RemoteFile(f"counted://{path}"), Limits())
    assert far.topics == near.topics
    assert far.metadata() == near.metadata()
    joints, image = PROFILE.topics.joints, PROFILE.topics.image
    for topics in (None, {joints}, {image}, {joints, image}, {"/none"}):
        assert everything(far, topics) == everything(near, topics)
    assert near.health.is_clean
    assert far.health.is_clean


def test_only_what_is_asked_for_is_fetched(tmp_path):
    """Of a log whose images stand in chunks of their own: its joints, without the images."""
    images = [("/image", "foxglove.CompressedImage", "protobuf", bytes(50_000), n) for n in range(240)]
    joints = [("/joints", "foxglove.JointStates", "protobuf", bytes(50), n) for n in range(240, 640)]
    path = write_messages(tmp_path / "apart.mcap", images + joints, "none")
    source = McapSource(RemoteFile(f"counted://{path}"), Limits())
    assert sum(1 for _ in source.messages({"/joints"})) == 400
    fetched, size = FETCHED[str(path)], path.stat().st_size
    assert 0 < fetched < size / 3, (fetched, size)


def test_an_index_that_points_beyond_the_file_is_a_loss(log):
    """Right by its CRC, as where a store has cut the file and kept its end."""
    source = McapSource(RemoteFile(f"counted://{log}"), Limits())
    for index in source.summary.chunk_indexes:
        index.chunk_start_offset += 1 << 40
    assert everything(source) == []
    assert "the statistics declare" in str(source.health.losses)


def test_a_database_is_not_read_from_afar(tmp_path):
    path = tmp_path / "log.db3"
    path.write_bytes(b"SQLite format 3\0" + bytes(84))
    with pytest.raises(RecordingError, match="a database is read from a disk only: download it first"):
        open_recording(f"counted://{path}", PROFILE)


@pytest.mark.parametrize(("harm", "said"), [("gone", "the store is gone"), ("short", "bytes came of")])
def test_a_store_that_fails_is_one_line(log, harm, said):
    HARM[str(log)] = harm
    with pytest.raises(RecordingError, match=f"cannot read: .*{said}") as raised:
        open_recording(f"counted://{log}", PROFILE)
    assert "\n" not in str(raised.value)


def test_a_server_without_ranges_gives_the_file_whole(log, monkeypatch):
    monkeypatch.setattr(SimpleHTTPRequestHandler, "log_message", lambda *_: None)
    handler = partial(SimpleHTTPRequestHandler, directory=str(log.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/log.mcap"
        assert everything(McapSource(RemoteFile(url), Limits())) == everything(McapSource(log, Limits()))
        with pytest.raises(RecordingError, match="no such file"):
            open_recording(f"http://127.0.0.1:{server.server_port}/none.mcap", PROFILE)
        # A copy that is kept no longer is closed: Python warns of one that is not.
        for number in range(remote.FILES_KEPT):
            assert RemoteFile(f"{url}?copy={number}").size_bytes() == log.stat().st_size
        server.shutdown()


@pytest.mark.parametrize("status", [403, 500, 404])
def test_what_a_server_refuses_is_there(status):
    class Refused(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_error(status)

        do_HEAD = do_GET
        log_message = staticmethod(lambda *_: None)

    with ThreadingHTTPServer(("127.0.0.1", 0), Refused) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        said = "no such file" if status == 404 else f"cannot read: {status} "
        with pytest.raises(RecordingError, match=said):
            open_recording(f"http://127.0.0.1:{server.server_port}/a.mcap", PROFILE)
        server.shutdown()


def test_a_silent_server_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(remote, "ANSWER_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}/a.mcap"
        with pytest.raises(RecordingError, match="no answer within"):
            open_recording(url, PROFILE)


@pytest.mark.parametrize("count", [150, pytest.param(4000, marks=pytest.mark.fault)])
def test_flipped_bits_give_no_wrong_value_and_no_silent_loss(log, tmp_path, count):
    """Read by the index: a message that comes is one that was written, and one that does not is reported."""
    path = rewrite(log, tmp_path / "small.mcap", "zstd")
    rng, data = random.Random(count), path.read_bytes()
    topics = {PROFILE.topics.joints}
    intact = everything(McapSource(path, Limits()), topics)
    memory = fsspec.filesystem("memory")
    found_less = 0
    for _ in range(count):
        memory.pipe_file("/flipped.mcap", flip_bit(data, rng))
        source = McapSource(RemoteFile("memory://flipped.mcap"), Limits())
        try:
            found = everything(source, topics)
        except RecordingError:
            found_less += 1
            continue
        assert is_subsequence(found, intact), "a message that nobody wrote"
        if len(found) < len(intact):
            found_less += 1
            assert not source.health.is_clean, "messages are missing, and nothing says so"
    assert 0 < found_less < count
