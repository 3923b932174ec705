"""Jobs for tests of the machinery: they say when they begin, wait at a gate, fail, or kill their own process."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from svmdist.errors import RecordingError, UsageError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.batch.task import LogFile, Measurement, Note, RowWriter

PATIENCE_S = 120.0


@dataclass(frozen=True)
class Counted:
    """How many messages a log has."""

    messages: int


@dataclass(frozen=True)
class CountJob:
    """Counts the messages of a log, and writes a row for each topic.

    Of logs in `held` the first attempt waits until the folder has a file `open`; those in `killed` kill their process,
    once or every time; `broken` fail.
    """

    folder: Path
    held: tuple[str, ...] = ()
    killed_once: tuple[str, ...] = ()
    killed: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    faulty: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()

    @property
    def result_type(self) -> type[Counted]:
        """The type of a result."""
        return Counted

    def measure(self, log: LogFile, threads: int, write: RowWriter) -> Measurement[Counted]:
        """Count."""
        begun = self.folder / f"begun-{log.name}"
        is_first = not begun.exists()
        with begun.open("a") as file:
            file.write(f"{os.getpid()}\n")
        if log.name in self.killed or (log.name in self.killed_once and is_first):
            os.kill(os.getpid(), signal.SIGKILL)
        if log.name in self.held:
            end_s = time.monotonic() + PATIENCE_S
            while not (self.folder / "open").exists():
                assert time.monotonic() < end_s, "nobody opened the gate"
                time.sleep(0.01)
        if log.name in self.broken:
            raise RecordingError(f"{log.name}: broken on purpose")
        if log.name in self.refused:
            raise UsageError("nothing can be measured so")
        if log.name in self.faulty:
            raise KeyError("a fault")
        recording = open_recording(log.path, load_profile())
        counts: dict[str, int] = {}
        for raw in recording.raw_messages():
            counts[raw.topic] = counts.get(raw.topic, 0) + 1
        for topic, count in sorted(counts.items()):
            write({"topic": topic, "count": count, "log": log.name})
        return Measurement(
            Counted(sum(counts.values())), recording.health, recording.metadata, (Note(f"read {log.name}"),)
        )

    def pids_of(self, name: str) -> list[int]:
        """The processes that began a log."""
        try:
            return [int(line) for line in (self.folder / f"begun-{name}").read_text().split()]
        except FileNotFoundError:
            return []
