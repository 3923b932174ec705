"""The parts of commands that need no log: options parsed, rules made, outputs refused before the work."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from svmdist.cli.alarms import alarm_rules
from svmdist.cli.blur_bench import blur_bench_command
from svmdist.cli.degradations import parse_degradations, parse_names, parse_severities

from svmdist.cli.calibrate import calibrate_command
from svmdist.cli.compare import compare_command
from svmdist.cli.main import app
from svmdist.cli.validate import TruthChoice, validate_command
from svmdist.errors import OutputError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.workflows.scoring.truth import Reference


def test_the_choices_of_truth_are_the_references() -> None:
    """The command line lists them without loading the workflow; both lists are the same, the strongest first."""
    assert [choice.value for choice in TruthChoice] == [reference.value for reference in Reference]


def test_alarm_options_make_rules() -> None:
    """A length in m, and the default of 0.05; without a threshold there are no rules."""
    assert alarm_rules("5mm", None, "fused") == AlarmRules(5e-3)
    assert AlarmRules(5e-3).confidence == 0.05
    assert alarm_rules("1cm", 0.5, "fused") == AlarmRules(1e-2, 0.5)
    assert alarm_rules(None, None, "overlay") is None
    with pytest.raises(UsageError, match="--alarm-confidence is for --alarm-below"):
        alarm_rules(None, 0.5, "fused")
    with pytest.raises(UsageError, match="overlay measures in the plane"):
        alarm_rules("5mm", None, "overlay")


def test_degradations_are_parsed() -> None:
    """Pairs in their order, and lists with blanks around the names."""
    assert parse_degradations("--degrade", ["smoke=3", "noise=1"]) == (("smoke", 3), ("noise", 1))
    assert parse_degradations("--degrade", None) == ()
    assert parse_names("--degradations", "smoke, noise") == ["smoke", "noise"]
    assert parse_severities("--severities", "1, 5") == [1, 5]


@pytest.mark.parametrize("command", [validate_command, compare_command, blur_bench_command])
def test_an_output_that_cannot_be_written_is_refused_first(command: object, tmp_path: Path) -> None:
    """The log does not exist, but the folder of the output is what is told."""
    assert callable(command)
    with pytest.raises(OutputError, match="there is no folder"):
        command([tmp_path / "no.mcap"], output=tmp_path / "no folder" / "a.csv")


def test_a_calibration_is_replaced_only_by_force(tmp_path: Path) -> None:
    """The file stays as it was."""
    output = tmp_path / "c.toml"
    output.write_text("kept")
    with pytest.raises(UsageError, match="exists; --force replaces it"):
        calibrate_command([tmp_path / "no.mcap"], output)
    assert output.read_text() == "kept"


def test_every_option_is_explained_by_sentences() -> None:
    """The help of each command and option ends with a full stop."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for name in ("validate", "compare", "blur-bench", "calibrate"):
        assert commands[name].help.strip().endswith(".")
        for option in commands[name].params:
            help_text = getattr(option, "help", None)
            assert not help_text or help_text.endswith("."), f"{name} {option.name}"
