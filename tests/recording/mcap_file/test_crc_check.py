"""The CRC of the data section: right, wrong, or none, and read once."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.profile import Limits
from svmdist.recording.mcap_file.crc_check import DataSectionCheck
from tests.recording.builders import rewrite
from tests.recording.faults import split

DATA_END = 15


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory, native: Path) -> Path:
    """A recording whose data section has a CRC."""
    return rewrite(native, tmp_path_factory.mktemp("crc") / "a.mcap", "zstd")


def check(path: Path, data: bytes) -> bool | None:
    """The answer for a file of these bytes."""
    path.write_bytes(data)
    return DataSectionCheck(path, Limits()).result()


def test_an_intact_file_is_right(intact: Path) -> None:
    assert DataSectionCheck(intact, Limits()).result() is True


def test_a_flipped_byte_of_any_record_before_the_end_is_told(tmp_path: Path, intact: Path) -> None:
    """The CRC covers heads and bodies; a byte in the middle of each record's body is flipped."""
    data = intact.read_bytes()
    end = next(part.offset for part in split(data) if part.opcode == DATA_END)
    covered = [part for part in split(data) if part.end <= end and part.body]
    assert len(covered) > 3
    for part in covered:
        broken = bytearray(data)
        broken[part.end - (len(part.body) + 1) // 2] ^= 1
        assert check(tmp_path / "a.mcap", bytes(broken)) is False


def test_without_a_crc_there_is_no_answer(tmp_path: Path, native: Path) -> None:
    path = rewrite(native, tmp_path / "a.mcap", "zstd", data_crc=False)
    assert DataSectionCheck(path, Limits()).result() is None


def test_a_truncated_file_has_no_answer_and_one_with_an_end_but_no_data_end_is_wrong(
    tmp_path: Path, intact: Path
) -> None:
    data = intact.read_bytes()
    end = next(part for part in split(data) if part.opcode == DATA_END)
    assert check(tmp_path / "a.mcap", data[: end.offset]) is None
    assert check(tmp_path / "b.mcap", data[: end.offset] + data[end.end :]) is False


def test_the_file_is_read_once(tmp_path: Path, intact: Path) -> None:
    """When first asked, and not before: the answer stands although the file is gone."""
    path = tmp_path / "a.mcap"
    answer = DataSectionCheck(path, Limits())
    path.write_bytes(intact.read_bytes())
    assert answer.result() is True
    path.unlink()
    assert answer.result() is True
