"""A job for batches of logs: it counts images, and goes wrong as a file says."""

import os
import signal
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.errors import RecordingError, UsageError
from svmdist.recording.log import Recording
from svmdist.transforms import Array
from svmdist.workflows.parallel import is_worker
from svmdist.workflows.request import LOG, Request
from tests.reading import read_images


@dataclass(frozen=True)
class Counted:
    """What the job finds: a number, an array with a hole, and texts by name."""

    images: int
    values: Array
    names: dict[str, str]


def count_images(
    recording: Recording, _request: Request, _threads: int, folder: str
) -> Generator[dict[str, Any], None, Counted]:
    """A row for each image; a file in the folder says what goes wrong with a log, and each attempt is written there."""
    name = recording.name
    with (Path(folder) / f"{name}.attempts").open("a") as file:
        file.write(f"{os.getpid()}\n")
    fate = Path(folder) / f"{name}.fate"
    what = fate.read_text() if fate.exists() else ""
    LOG.info("note: the same of all")
    LOG.debug("only of %s", name)
    if what == "broken":
        raise RecordingError(f"{name} is broken")
    if what == "fault":
        raise ZeroDivisionError("a fault")
    if what == "usage":
        raise UsageError("wrong for all")
    if what == "killed" and is_worker():
        os.kill(os.getpid(), signal.SIGKILL)
    while what == "held" and not (Path(folder) / "open").exists():
        time.sleep(0.01)
    count = 0
    for number, _ in enumerate(read_images(recording)):
        yield {"recording": name, "number": number, "nothing": None}
        count += 1
    return Counted(count, np.array([1.5, np.nan, count]), {"name": name})
