"""What the machine can run out of, told in a line: memory, files, threads, space. Anything else is a fault of ours."""

from __future__ import annotations

import re

NO_MEMORY = "there is not enough memory; try fewer --jobs"
CV_NO_MEMORY = -4
"""OpenCV's code of an allocation that failed."""
LIBRARY_NOT_LOADED = re.compile(
    r"failed to map segment|cannot allocate memory|cannot open shared object", re.IGNORECASE
)


def what_lacks(error: BaseException) -> str | None:
    """Say what of the machine was exhausted when this was raised; None where it was something else.

    Every allocation, file and thread anywhere can be the one too many: there is no deeper place than this to look.
    """
    match error:
        case MemoryError():
            return NO_MEMORY
        case OSError(strerror=str(reason)):
            name = f"{error.filename}: " if isinstance(error.filename, str) else ""
            return f"{name}{reason}"
        case OSError():
            return str(error) or type(error).__name__
        case RuntimeError() if "can't start new thread" in str(error):
            return "no thread can be started; try --jobs 1"
        case ImportError() if LIBRARY_NOT_LOADED.search(str(error)):
            return f"a library cannot be loaded, perhaps for want of memory: {' '.join(str(error).split())}"
        case _:
            is_opencv = type(error).__module__ == "cv2" and type(error).__name__ == "error"
            return NO_MEMORY if is_opencv and getattr(error, "code", 0) == CV_NO_MEMORY else None
