"""Looks for inputs that a parser cannot bear, guided by coverage: atheris, on the targets of `test_mutants.py`.

    uv run --with atheris python -m tests.fuzz mcap -max_total_time=600 -max_len=65536

Inputs that reach new code join the corpus in `tests/data/corpus`: keep those that are small. One that fails is written
to the working folder, and belongs there too, when it is mended. atheris has wheels for Linux and macOS.
"""

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["svmdist"]):
    from tests.recording.test_mutants import CORPUS, TARGETS


def main() -> None:
    """Fuzz the target that is named, with the options of libFuzzer behind it."""
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"usage: python -m tests.fuzz TARGET [-option=value …]; the targets are {', '.join(TARGETS)}")
    target, *options = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        atheris.Setup([sys.argv[0], str(CORPUS / target), *options], lambda data: TARGETS[target](data, Path(folder)))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
