"""The command `svmdist`, also as `python -m svmdist`. Light to import, so that an interrupt finds it ready."""

import gc
import os
import sys

# Plugins of pydantic are no part of svmdist; looking for them reads the metadata of every installed package.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

COLLECT_AFTER = 20_000
"""Objects between two garbage collections, in place of Python's 700: start-up alone makes 50,000, all to stay."""


def run() -> None:
    """Entry point: run the command line; an interrupt ends it with a line and 130, while it still loads, too."""
    gc.set_threshold(COLLECT_AFTER)
    try:
        from svmdist.cli.main import run as run_commands

        run_commands()
    except KeyboardInterrupt:
        print("svmdist: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        import signal

        # What is left is Python's own clean-up: an interrupt there shall end it, not print where it was.
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    run()
