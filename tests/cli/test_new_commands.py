"""Commands that make what others read: their choices are those of the program, and wrong use is one line."""

from __future__ import annotations

from pathlib import Path

from svmdist.cli.hand_eye import Against, SeeingMethod
from svmdist.cli.importing import import_command
from svmdist.cli.profile import new_command
from svmdist.estimation.methods import METHODS
from tests.cli.conftest import Cli


def test_what_sees_the_tool_is_a_method() -> None:
    assert {method.value for method in SeeingMethod} <= set(METHODS)
    assert {choice.value for choice in Against} == {"kinematics", "pose"}


def test_help_is_what_the_command_says(cli: Cli) -> None:
    """The first line of each docstring opens the help."""
    for arguments, command in ((("import",), import_command), (("profile", "new"), new_command)):
        first = (command.__doc__ or "").strip().splitlines()[0]
        shown = " ".join(cli(*arguments, "--help").out.split())
        assert first in shown


def test_a_source_that_is_not_there_is_one_line(cli: Cli, tmp_path: Path) -> None:
    for arguments in (("import", str(tmp_path / "no")), ("profile", "new", str(tmp_path / "no.mcap"))):
        outcome = cli(*arguments, "-o", str(tmp_path / "out.mcap"))
        assert outcome.code in {1, 2}
        assert "Traceback" not in outcome.err
