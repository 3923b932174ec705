"""The command `svmdist`, also as `python -m svmdist`. Light to import, so that an interrupt finds it ready."""

import sys


def run() -> None:
    """Entry point: run the command line; an interrupt ends it with a line and 130, while it still loads, too."""
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
