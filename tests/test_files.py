"""A file that a command writes is whole, or what it was before."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from svmdist.files import BusyError, lock, write_atomically


def _cut_short(error: BaseException) -> Iterator[str]:
    yield "first\n"
    raise error


@pytest.mark.parametrize("before", [None, "what was there\n"])
@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), RuntimeError("in the middle")], ids=["interrupt", "error"]
)
def test_a_write_that_ends_early_changes_nothing(
    tmp_path: Path, before: str | None, error: BaseException
) -> None:
    """An interrupt or an error leaves the folder as it was."""
    path = tmp_path / "rows.csv"
    if before is not None:
        path.write_text(before)
    with pytest.raises(type(error)):
        write_atomically(path, _cut_short(error))
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == (
        [("rows.csv", before)] if before else []
    )


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    """A link goes on leading to the same file, which keeps who may read it."""
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    write_atomically(link, ["new"])
    assert link.is_symlink()
    assert (real.read_text(), real.stat().st_mode & 0o777) == ("new", 0o640)


def test_a_pipe_is_written_in_place(tmp_path: Path) -> None:
    """What is no regular file is never replaced."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, ["through\n"])
    assert os.read(reader, 100) == b"through\n"
    os.close(reader)
    assert pipe.is_fifo()


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    """Temporary files of this name that nobody holds go; those of another name, or of a process at work, stay."""
    path = tmp_path / "rows.csv"
    names = (".rows.csv.77.part", ".rows.csv.x.part", ".rows.csv.78.part")
    stale, other, at_work = (tmp_path / name for name in names)
    for left in (stale, other, at_work):
        left.write_text("half")
    held = lock(at_work, "wb")
    write_atomically(path, ["whole\n"])
    os.close(held)
    assert not stale.exists()
    assert sorted(tmp_path.iterdir()) == sorted([path, other, at_work])


def test_a_lock_is_held_by_one(tmp_path: Path) -> None:
    """A second one is refused until the first has ended; then the file is emptied for it."""
    path = tmp_path / "log.part"
    number = lock(path, "xb")
    os.write(number, b"half")
    with pytest.raises(BusyError):
        lock(path, "wb")
    assert path.read_bytes() == b"half"
    os.close(number)
    with pytest.raises(FileExistsError):
        lock(path, "xb")
    os.close(lock(path, "wb"))
    assert path.read_bytes() == b""


@pytest.mark.parametrize("length", [8, 200, 250, 255])
def test_the_name_appears_with_the_last_line(tmp_path: Path, length: int) -> None:
    """While lines come there is no file of that name; then it holds all of them, and nothing stands beside it."""
    path = tmp_path / ("n" * length)

    def lines() -> Iterator[str]:
        yield "é\r\n"
        assert not path.exists()
        yield "last\n"

    write_atomically(path, lines())
    assert path.read_bytes() == "é\r\nlast\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_a_lock_is_that_of_the_file_under_the_name(tmp_path: Path) -> None:
    """Opening a name anew after its file was renamed makes a new file and leaves the renamed one."""
    path, final = tmp_path / "log.part", tmp_path / "log"
    first = lock(path, "xb")
    os.write(first, b"whole")
    path.rename(final)
    second = lock(path, "wb")
    os.write(second, b"other")
    os.close(first)
    os.close(second)
    assert (final.read_bytes(), path.read_bytes()) == (b"whole", b"other")
