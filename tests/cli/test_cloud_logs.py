"""Logs in an S3 store that is served here, and in memory: the same rows as from a disk."""

import logging
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from tests.synthetic import write_log

pytest.importorskip("s3fs", reason="the extra cloud is not installed")
pytest.importorskip("moto", reason="the group heavy is not installed")
pytestmark = pytest.mark.filterwarnings("default")  # of boto's own


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("cloud") / "day"
    made.mkdir()
    for number in range(3):
        write_log(made / f"log{number}.mcap", frame_count=2 + number)
    return made


@pytest.fixture
def bucket(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An S3 store with the logs, and the environment that leads to it."""
    import fsspec
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    _, port = server.get_host_and_port()
    for name, value in {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
    }.items():
        monkeypatch.setenv(name, value)
    filesystem = fsspec.filesystem("s3", skip_instance_cache=True)
    filesystem.mkdir("logs")
    for path in sorted(folder.glob("*.mcap")):
        filesystem.pipe_file(f"logs/day/{path.name}", path.read_bytes())
    yield "s3://logs/day"
    server.stop()
    fsspec.filesystem("s3").clear_instance_cache()


def test_s3_gives_the_rows_of_a_disk(cli, bucket, folder, tmp_path):
    """By one process and by two; what fails there is one line; what is done is known by what the store says of it."""
    expected = cli("estimate", folder, "-f", "csv").out
    results = tmp_path / "results"
    asked = ("-f", "csv", "--resume", results)
    assert cli("estimate", f"{bucket}/*.mcap", *asked, "--jobs", "2").out == expected
    next(results.glob("log1*.json")).unlink()
    again = cli("estimate", bucket, *asked, "--jobs", "1")
    assert again.out == expected
    assert "2 of 3 logs are done" in again.err
    missing = cli("estimate", f"{bucket}/none.mcap", code=1)
    assert missing.err == f"svmdist: {bucket}/none.mcap: no such file\n"
    nothing = cli("estimate", f"{bucket}/*.bag", code=2)
    assert nothing.err == f"svmdist: {bucket}/*.bag: no log matches\n"


def test_memory_gives_the_rows_of_a_disk(cli, folder):
    """A process's memory is its own: these logs are measured in this one."""
    import fsspec

    for path in folder.glob("*.mcap"):
        fsspec.filesystem("memory").pipe_file(f"/cloud/{path.name}", path.read_bytes())
    expected = cli("estimate", folder, "-f", "csv").out
    assert cli("estimate", "memory://cloud", "-f", "csv", "--jobs", "2").out == expected
    assert "images" not in cli("info", "memory://cloud/log1.mcap").out.splitlines()[0]


def test_no_file_shows_a_secret(cli, folder, tmp_path, monkeypatch):
    """Rows, results that are kept, and the report's command line, of a log behind a URL with password and token."""
    pytest.importorskip("plotly", reason="the report needs plotly")
    monkeypatch.setattr(SimpleHTTPRequestHandler, "log_message", lambda *_: None)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=folder)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://me:SECRET@127.0.0.1:{server.server_port}/log0.mcap?token=SECRET"
        asked = ["estimate", url, "--resume", "kept", "-v", "-o", "rows.json", "--report", "report.html"]
        monkeypatch.chdir(tmp_path)
        assert "SECRET" not in cli(*asked).err
        server.shutdown()
    texts = [path.read_text("utf-8") for path in tmp_path.rglob("*.*") if path.is_file()]
    assert len(texts) == 3
    assert not any("SECRET" in text for text in texts)
    assert any(f"svmdist estimate http://127.0.0.1:{server.server_port}/log0.mcap --resume" in text for text in texts)
