"""Every command that README and docs print runs as printed, in the folder of a fresh clone.

Each document's commands run in their order, in a folder of their own. bash resolves them; `uv` is replaced by a call in
this process. To be quick, commands about logs take few frames (`SHORT`); `pytest -m fault` runs them as they are.
"""

import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.cli.printed_files import PREPARE
from tests.conftest import REPOSITORY, Cli
from tests.test_docs import DOCUMENTS

ONE_PROCESS = ["--jobs", "1"]
SHORT = {
    "record": ["--duration", "1", "--rate", "4", *ONE_PROCESS],
    "estimate": ["--every", "20", *ONE_PROCESS],
    "validate": ["--every", "8", *ONE_PROCESS],
    "compare": ["--every", "40", *ONE_PROCESS],
    "blur-bench": ["--every", "40", *ONE_PROCESS],
}
"""What is added to a command about golden logs, and to `record`, where it is to be quick. Later options win."""
NOT_RUN = {
    "--group test pytest": "it is this run",
    "python -m benchmarks.speed logs": "compares programs for minutes",
    "python -m benchmarks.golden_tables": "measures all golden logs for minutes",
    "python -m benchmarks.ablate LOG.mcap --write": "measures logs a dozen times for minutes",
    "python -m benchmarks.real.ablate sets --write": "needs public sets that are not in the repository",
    "python -m benchmarks.robustness LOG.mcap --write": "measures a log in many worlds for minutes",
    "python -m benchmarks.alarms LOG.mcap --write": "measures logs by every method for minutes",
    "python -m benchmarks.generated_pages": "another test compares its pages with the code",
    "python -m benchmarks.real sets --out real-images --write": "needs the sets that the lines above clone",
    "svmdist import thrust/50_images_15-Nov-17-59-04 --pattern *_L.jpg --right-pattern *_R.jpg --rate 1"
    " --camera 572.22,572.22,378.77,239.29 --baseline 61.95mm -o thrust.mcap": "needs what the line above clones",
    "svmdist profile new thrust.mcap --instrument large-needle-driver -o thrust.toml": "as the line above",
    "svmdist estimate thrust.mcap --profile thrust.toml": "as the lines above",
    "python -m benchmarks.masks sets": "needs the sets that the line above clones",
}
"""Calls of `uv run` that are not made, each with the reason."""
OTHER_PROGRAMS = {
    "git clone": "public image sets, of gigabytes",
    "pip install": "changes the environment; .ci/run installs the wheel",
    "python -m training.train": "needs PyTorch, which is no dependency, and an hour",
    "python -m grpc_tools": "needs a compiler of protobuf that is no dependency",
    "grep -o": "reads what that compiler wrote",
}
"""Beginnings of commands of other programs, which are not run, each with the reason."""
SHELL_FENCE = re.compile(r"^```(console|bash|sh|shell)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RECORDER = "uv() { printf '%s\\0' \"$@\" $'\\x1e'; }"
"""Stands for the program `uv`: it prints its arguments, and runs nothing."""


@dataclass(frozen=True)
class Command:
    """One command as printed, which may continue on further lines, and where it stands: `document:line`."""

    place: str
    text: str

    @property
    def is_run(self) -> bool:
        """Whether it is not one of other programs that are listed as not run."""
        return not self.text.startswith(tuple(OTHER_PROGRAMS))

    def calls(self, folder: Path) -> list[list[str]]:
        """What follows `uv` in each of its calls, with quotes, globs and loops as bash resolves them in a folder."""
        script = f"{RECORDER}\n{self.text}"
        done = subprocess.run(["bash", "-euc", script], cwd=folder, capture_output=True, text=True, check=True)
        return [call.strip("\0").split("\0") for call in done.stdout.split("\x1e\0")[:-1]]


def commands_of(document: Path) -> list[Command]:
    """Every command of a document: a line that begins with `$ `, and the lines below it that do not."""
    text = document.read_text("utf-8")
    name = document.relative_to(REPOSITORY).as_posix()
    found = []
    for fence in SHELL_FENCE.finditer(text):
        first_line = text[: fence.start(2)].count("\n") + 1
        lines = fence[2].splitlines()
        starts = [number for number, line in enumerate(lines) if line.startswith("$ ")]
        if fence[1] != "console" or not starts or starts[0] != 0:
            raise ValueError(f"{name}:{first_line}: commands are printed as ```console, each behind `$ `")
        for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
            found.append(Command(f"{name}:{first_line + start}", "\n".join(lines[start:end])[2:]))
    return found


PRINTED = {
    document.relative_to(REPOSITORY).as_posix(): commands
    for document in DOCUMENTS
    if document.name != "CHANGELOG.md" and (commands := commands_of(document))
}
FIRST = {"README.md", "docs/quick-start.md"}
"""What a stranger runs first; the commands of other pages are slow tests."""
WRITE_TO_RECORDINGS = {"recordings/README.md"}


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what a clone has at its top, to run in; what commands write stays in it."""
    for entry in REPOSITORY.iterdir():
        if not entry.name.startswith(".") and entry.name != "recordings":
            (tmp_path / entry.name).symlink_to(entry)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made_here(clone: Path, arguments: list[str]) -> bool:
    """Whether a command reads a log that stands in the folder itself, not a golden one."""
    return any((clone / argument).is_file() for argument in arguments if "/" not in argument)


@pytest.fixture(scope="module")
def done() -> set[str]:
    """Calls that have run, which read golden logs alone and whose results no later command takes: once is enough."""
    return set()


def run(document: str, clone: Path, cli: Cli, done: set[str], *, short: bool) -> None:
    if document in WRITE_TO_RECORDINGS:
        shutil.copytree(REPOSITORY / "recordings", clone / "recordings")
        (clone / "svmdist").unlink()
        shutil.copytree(REPOSITORY / "svmdist" / "profiles", clone / "svmdist" / "profiles")
    else:
        (clone / "recordings").symlink_to(REPOSITORY / "recordings")
    if document in PREPARE:
        PREPARE[document](clone)
    for command in PRINTED[document]:
        if not command.is_run:
            continue
        calls = command.calls(clone)
        assert calls, f"{command.place}: not a call of uv, and not listed: {command.text}"
        for call in calls[:1] if short else calls:  # of a loop, one turn is enough where it is to be quick
            assert call[0] == "run", f"{command.place}: uv {call}"
            if " ".join(call[1:]) in NOT_RUN:
                continue
            program, *arguments = call[3:] if call[1] == "--extra" else call[1:]
            assert program == "svmdist", f"{command.place}: neither svmdist nor listed: {call}"
            if short and (arguments[0] == "record" or not made_here(clone, arguments[1:2])):
                arguments += SHORT.get(arguments[0], [])
            if (asked := shlex.join(arguments)) in done:
                continue
            if document not in WRITE_TO_RECORDINGS and "-o" not in arguments and not made_here(clone, arguments):
                done.add(asked)
            cli(*arguments)
            if short and arguments[0] == "record" and document in WRITE_TO_RECORDINGS:
                target = arguments[arguments.index("-o") + 1]  # the next commands need the golden log in full
                shutil.copy2(REPOSITORY / target, clone / target)


@pytest.mark.parametrize(
    "document", [name if name in FIRST else pytest.param(name, marks=pytest.mark.slow) for name in PRINTED]
)
def test_printed_commands_run(document, clone, cli, done):
    """As printed, but on few frames."""
    run(document, clone, cli, done, short=True)


@pytest.mark.fault
@pytest.mark.parametrize("document", PRINTED)
def test_printed_commands_run_in_full(document, clone, cli, done):
    run(document, clone, cli, done, short=False)


def test_the_lists_of_what_is_not_run_are_no_longer_than_needed():
    """Each entry is a command that some document prints: one that is gone from the documents goes from the lists."""
    printed = [command for commands in PRINTED.values() for command in commands]
    others = {start for start in OTHER_PROGRAMS for command in printed if command.text.startswith(start)}
    assert others == set(OTHER_PROGRAMS)
    calls = [call for command in printed if command.is_run for call in command.calls(REPOSITORY)]
    assert set(NOT_RUN) <= {" ".join(call[1:]) for call in calls}
