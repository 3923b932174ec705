"""A system that runs out of something, or knows other letters: one line and exit code 1, or plain ASCII."""

import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import ended, one_line
from tests.synthetic import write_log

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


@pytest.mark.parametrize(
    ("form", "encoding"),
    [
        *(("table", encoding) for encoding in ("ascii", "latin-1", "cp1252")),
        *((form, "ascii") for form in ("csv", "json", "jsonl")),
        ("json", "cp1252"),
    ],
)
def test_other_encodings(tmp_path, encoding, form):
    """Tables fall back to ASCII, and JSON stays what it is, whatever stdout is encoded in."""
    log = write_log(tmp_path / "größe–Ω.mcap", frame_count=3)
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
        assert len(text.splitlines()) > 3
        assert ("gr??e-?" if encoding == "ascii" else "größe") in text


@pytest.mark.parametrize("command", ["info", "estimate"])
def test_a_name_that_is_not_utf8(tmp_path, command):
    """Bytes of a file's name that are no text are shown as unknown characters."""
    log = write_log(Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff\xfe.mcap")), frame_count=3)
    out = tmp_path / "out"
    cases = (
        ("table", "utf-8", ()),
        ("table", "ascii", ()),
        ("json", "ascii", ()),
        ("json", "utf-8", ("-o", out)),
    )
    for form, encoding, to in cases:
        done = ended(command, log, "-f", form, *to, environment={"PYTHONIOENCODING": encoding})
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        if form == "json":
            text = out.read_text("utf-8") if to else done.stdout
            shown = json.dumps(json.loads(text), ensure_ascii=False)
            assert "a\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}" in shown
