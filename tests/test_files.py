"""A file that a command writes is whole, or what it was before; a file to read is a regular one within its limit."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from svmdist.errors import OutputError
from svmdist.files import write_atomically


def _cut_short(error: BaseException) -> Iterator[str]:
    yield "first\n"
    raise error


@pytest.mark.parametrize("before", [None, "what was there\n"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("in the middle")], ids=["interrupt", "error"])
def test_a_write_that_ends_early_changes_nothing(tmp_path, before, error):
    """An interrupt or an error leaves the folder as it was."""
    path = tmp_path / "rows.csv"
    if before is not None:
        path.write_text(before)
    with pytest.raises(type(error)):
        write_atomically(path, _cut_short(error))
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == ([("rows.csv", before)] if before else [])


def test_links_and_permissions_stay(tmp_path):
    """A link goes on leading to the same file, which keeps who may read it."""
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    write_atomically(link, ["new"])
    assert link.is_symlink()
    assert (real.read_text(), real.stat().st_mode & 0o777) == ("new", 0o640)


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    """In a folder that others write to, a link may appear where the temporary file is about to be made."""
    path, theirs = tmp_path / "rows.csv", tmp_path / "theirs"
    theirs.write_text("precious")
    monkeypatch.setattr(type(path), "unlink", lambda part, **_: part.is_symlink() or part.symlink_to(theirs))
    with pytest.raises(OutputError, match="File exists"):
        write_atomically(path, ["new"])
    assert theirs.read_text() == "precious"


def test_a_pipe_is_written_in_place(tmp_path):
    """What is no regular file is never replaced."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, ["through\n"])
    assert os.read(reader, 100) == b"through\n"
    os.close(reader)
    assert pipe.is_fifo()
    reader, writer = os.pipe()
    write_atomically(Path(f"/dev/fd/{writer}"), ["nameless\n"])
    assert os.read(reader, 100) == b"nameless\n"
    os.close(reader)
    os.close(writer)


@pytest.mark.parametrize("length", [8, 200, 250, 255])
def test_the_name_appears_with_the_last_line(tmp_path, length):
    """While lines come there is no file of that name; then it holds all of them, and nothing stands beside it."""
    path = tmp_path / ("n" * length)

    def lines() -> Iterator[str]:
        yield "é\r\n"
        assert not path.exists()
        yield "last\n"

    write_atomically(path, lines())
    assert path.read_bytes() == "é\r\nlast\n".encode()
    assert list(tmp_path.iterdir()) == [path]
