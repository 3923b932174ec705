"""Every command has examples in its help, which can be typed as they stand."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from svmdist.cli.command import QUIET, VERBOSE, Command
from svmdist.cli.examples import EXAMPLES, Example
from svmdist.cli.main import app
from tests.cli.running import ended

MAX_WIDTH = 76
"""Two blanks before, and a terminal of 80 columns holds the line."""


def commands(command: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """All commands and groups, by their names on the command line."""
    yield name, command
    for own, member in getattr(command, "commands", {}).items():
        yield from commands(member, f"{name} {own}".strip())


ALL: dict[str, Any] = {name or "svmdist": command for name, command in commands(typer.main.get_command(app))}
EVERY = [(name, example) for name, examples in EXAMPLES.items() for example in examples]


def test_every_command_has_examples_and_no_other_has() -> None:
    assert set(EXAMPLES) == set(ALL)
    assert {"estimate", "blur-bench", "profile", "profile new"} <= set(ALL)
    for name, examples in EXAMPLES.items():
        assert examples, name
        if name not in ("svmdist", "profile"):
            assert any(
                example.command.split()[1:][: len(name.split())] == name.split() for example in examples
            )


@pytest.mark.parametrize(
    ("name", "example"), EVERY, ids=lambda value: value.command if isinstance(value, Example) else value
)
def test_examples_are_what_the_commands_read(name: str, example: Example) -> None:
    """The command's own parser reads the line: each option is its own, each value one of the choices."""
    words = shlex.split(example.command)
    assert words[0] == "svmdist"
    assert len(example.command) <= MAX_WIDTH
    found = max((other for other in ALL if words[1:][: len(other.split())] == other.split()), key=len)
    command = ALL[found]
    assert isinstance(command, Command)
    context = command.make_context(found, words[1 + len(found.split()) :])
    assert context.params
    assert not example.purpose.endswith((".", ":"))


@pytest.mark.parametrize("columns", ["40", "200"])
@pytest.mark.parametrize("name", ["svmdist", "estimate", "profile new"])
def test_examples_stand_unbroken_in_a_pipe_of_any_width(name: str, columns: str) -> None:
    words = [] if name == "svmdist" else name.split()
    done = ended(*words, "--help", environment={"COLUMNS": columns, "TERMINAL_WIDTH": columns})
    assert done.returncode == 0
    assert "\x1b" not in done.stdout
    lines = done.stdout.splitlines()
    begin = lines.index("Examples:")
    shown = [f"  {example.purpose}:\n    {example.command}" for example in EXAMPLES[name]]
    assert "\n".join(lines[begin + 1 :]).startswith("\n".join(shown))


def test_the_options_of_every_command_are_told() -> None:
    shown = ended("profile", "new", "--help").stdout
    assert all(option in shown for option in (*QUIET, *VERBOSE))
