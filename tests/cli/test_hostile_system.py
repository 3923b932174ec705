"""A system that runs out of something, or knows other letters: one line and exit code 1, or plain ASCII."""

import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import ended, one_line

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs the limits of Linux")
MIB = 1 << 20


@pytest.mark.parametrize(
    "arguments",
    [["info"], ["info", "-f", "json"], ["estimate"], ["estimate", "-f", "csv"], ["fk", "-f", "csv"]],
    ids=" ".join,
)
def test_a_full_stdout(synthetic_log, arguments):
    """What cannot be written is an error, whoever notices it: the write, the flush, or Python at its end."""
    command, *options = arguments
    with Path("/dev/full").open("w") as full:
        done = ended(command, synthetic_log, *options, stdout=full)
    assert done.returncode == 1
    assert one_line(done.stderr) == "svmdist: stdout: cannot write: No space left on device"


def limited(what: int, amount: int) -> Callable[[], None]:
    """A limit that holds from the start of the process."""
    return lambda: resource.setrlimit(what, (amount, amount))


def test_a_limit_of_file_sizes(tmp_path, synthetic_log):
    """`ulimit -f`: stdout in a file, and files of its own."""
    command = ["estimate", synthetic_log, "-f", "csv"]
    limit = limited(resource.RLIMIT_FSIZE, 2048)
    with (tmp_path / "stdout").open("w") as stdout:
        done = ended(*command, preexec_fn=limit, stdout=stdout)
    assert (done.returncode, one_line(done.stderr)) == (1, "svmdist: stdout: cannot write: File too large")
    done = ended(*command, "-o", tmp_path / "rows.csv", preexec_fn=limit)
    assert done.returncode == 1
    assert "rows.csv: cannot write: File too large" in one_line(done.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["stdout"]


@pytest.mark.parametrize("memory_mib", [150, 250, 350, 450, 600])
def test_a_limit_of_memory(synthetic_log, memory_mib):
    """`ulimit -v`: it works, or says in a line that memory is what it lacks; libraries may add lines of their own."""
    limit = limited(resource.RLIMIT_AS, memory_mib * MIB)
    command = ["estimate", synthetic_log, "-f", "csv", "-j", "1"]
    done = ended(*command, preexec_fn=limit, environment={"OPENBLAS_NUM_THREADS": "1"})
    assert "Traceback" not in done.stderr, done.stderr
    if done.returncode != 0:
        assert done.returncode == 1
        assert "memory" in done.stderr.strip().splitlines()[-1]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
@pytest.mark.parametrize("form", ["table", "csv", "json", "jsonl"])
def test_other_encodings(tmp_path, synthetic_log, encoding, form):
    """Tables fall back to ASCII, and JSON stays what it is, whatever stdout is encoded in."""
    log = tmp_path / "größe–Ω.mcap"
    log.write_bytes(synthetic_log.read_bytes())
    command = ["estimate", log, "-f", form]
    there = {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    done = ended(*command, environment=there, encoding=encoding, errors="strict")
    assert done.returncode == 0, done.stderr
    text = done.stdout
    if form in {"json", "jsonl"}:
        assert text.isascii()
        rows = json.loads(text) if form == "json" else [json.loads(line) for line in text.splitlines()]
        assert {row["recording"] for row in rows} == {"größe–Ω"}
    else:
        assert len(text.splitlines()) > 40
        assert ("gr??e-?" if encoding == "ascii" else "größe") in text


@pytest.mark.parametrize("command", ["info", "estimate"])
@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_name_that_is_not_utf8(tmp_path, synthetic_log, command, encoding):
    """Bytes of a file's name that are no text are shown as unknown characters."""
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff\xfe.mcap"))
    log.write_bytes(synthetic_log.read_bytes())
    for options in (["-f", "table"], ["-f", "json"], ["-f", "json", "-o", tmp_path / "out"]):
        done = ended(command, log, *options, environment={"PYTHONIOENCODING": encoding})
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        text = (tmp_path / "out").read_text("utf-8") if "-o" in options else done.stdout
        if "json" in options:
            shown = json.dumps(json.loads(text), ensure_ascii=False)
            assert "a\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}" in shown
