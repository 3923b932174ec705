"""The command `svmdist`, also as `python -m svmdist`. Light to import, so that an interrupt finds it ready."""

import gc
import os
import signal
import sys
from types import FrameType

from svmdist.errors import Terminated

# Plugins of pydantic are no part of svmdist; looking for them reads the metadata of every installed package.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# Matrices are small here: a second thread of linear algebra waits in a loop, and doubles the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end the process as an interrupt does: unfinished files are removed first."""
_asked_to_end: list[int] = []


def run() -> None:
    """Entry point: run the command line; an interrupt ends it with a line and 130, while it still loads, too."""
    gc.set_threshold(20_000)  # objects between two garbage collections: start-up alone makes 50,000, all to stay
    for number in range(3):  # a file that got the place of a closed standard stream would get what libraries print
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    _handle_signals()
    try:
        from svmdist.cli.main import run as run_commands

        run_commands()
    except (KeyboardInterrupt, Exception) as problem:
        # What is raised while a class is made is wrapped: by Python 3.11 as a cause, by pydantic as text.
        if _asked_to_end:
            print("svmdist: terminated", file=sys.stderr)
            sys.exit(128 + _asked_to_end[0])
        if "KeyboardInterrupt" in f"{problem!r} {problem.__cause__!r}":
            print("svmdist: interrupted", file=sys.stderr)
            sys.exit(130)
        raise
    finally:
        # What is left is Python's own clean-up: an interrupt there shall end it, not print where it was.
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _handle_signals() -> None:
    """Let signals that would end this process at once end it as an interrupt does."""
    owner = os.getpid()

    def end(number: int, _: FrameType | None) -> None:
        if os.getpid() != owner:  # a forked worker: its owner reports
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        for other in ENDING:
            signal.signal(other, signal.SIG_IGN)  # it is ending already
        _asked_to_end.append(number)
        raise Terminated(number)

    for number in ENDING:
        if signal.getsignal(number) == signal.SIG_DFL:  # `nohup` has it ignored
            signal.signal(number, end)
    sys.unraisablehook = _send_again


def _send_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again that came where Python ignores exceptions, as in an import's clean-up."""
    problem = lost.exc_value
    if not isinstance(problem, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    number = problem.signal_number if isinstance(problem, Terminated) else signal.SIGINT
    if number in ENDING:
        for ending in ENDING:
            signal.signal(ending, signal.SIG_DFL)
        _handle_signals()

    import threading  # here: until this module is loaded, an interrupt prints a traceback

    later = threading.Timer(0.02, os.kill, (os.getpid(), number))  # after Python has left that code
    later.daemon = True
    later.start()


if __name__ == "__main__":
    run()
