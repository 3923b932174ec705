"""The CRC check of the data section, which covers what stands outside of chunks."""

from __future__ import annotations

from mcap.opcode import Opcode

from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.mcap_file.framing import MAGIC, FrameStream
from svmdist.recording.mcap_file.summary import read_footer


class DataSectionCheck:
    """Reads a file once, when first asked, and remembers the answer."""

    def __init__(self, path: LogPath, limits: Limits) -> None:
        self._path = path
        self._limits = limits
        self._is_known = False
        self._result: bool | None = None

    def result(self) -> bool | None:
        """Tell whether the CRC is right; None where the file has none or ends before it."""
        if not self._is_known:
            self._result = self._read()
            self._is_known = True
        return self._result

    def _read(self) -> bool | None:
        with open_regular(self._path) as file:
            size_bytes = file.seek(0, 2)
            ends_well = read_footer(file, size_bytes) is not None
            file.seek(0)
            stream = FrameStream(file, size_bytes, self._limits)
            stream.read(len(MAGIC))
            while (frame := stream.next_frame()) is not None and frame.opcode != 0 and not frame.is_truncated:
                if frame.opcode == Opcode.DATA_END and frame.body is not None and len(frame.body) >= 4:
                    declared = int.from_bytes(frame.body[:4], "little")
                    return None if declared == 0 else declared == frame.crc_before
                if frame.opcode == Opcode.FOOTER:
                    break
        # A file with an end but without a data end is broken; one without an end was truncated.
        return False if ends_well else None
