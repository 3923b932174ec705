"""Many logs from the command line: folders, globs and URLs; one bad log; results that stay; groups and summaries."""

import csv
import re
from pathlib import Path

import pytest

from tests.synthetic import write_log

SCENARIOS = ("sweep", "sweep", "approach")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs of two scenarios, one of another, and files that are no logs."""
    made = tmp_path_factory.mktemp("many") / "logs"
    made.mkdir()
    for number, scenario in enumerate(SCENARIOS):
        path, metadata = made / f"log{number}.mcap", {"scenario": scenario, "seed": str(number)}
        write_log(path, frame_count=4 + number, metadata=metadata)
    (made / "notes.txt").write_text("no log")
    return made


@pytest.fixture
def with_bad(folder: Path, tmp_path: Path) -> Path:
    """The same logs with one that is cut, and one that is none."""
    made = tmp_path / "logs"
    made.mkdir()
    for path in folder.glob("*.mcap"):
        (made / path.name).write_bytes(path.read_bytes())
    whole = (folder / "log2.mcap").read_bytes()
    (made / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    (made / "junk.mcap").write_text("junk")
    return made


COMMANDS = [
    ("estimate",),
    ("validate",),
    ("compare", "--method", "overlay", "--method", "kinematic", "--end", "0.2"),
    ("blur-bench", "--end", "0.1"),
    ("info",),
    ("fk",),
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_gives_the_same_for_any_number_of_processes(cli, folder, command):
    """But for the processor time. A folder, a glob and the files themselves are the same logs."""
    files = [str(path) for path in sorted(folder.glob("*.mcap"))]
    asked = [(1, [str(folder)]), (2, [f"{folder}/*.mcap"])]
    if command == ("estimate",):
        asked += [(3, files), (2, [f"file://{folder}/log?.mcap"])]
    found = []
    for jobs, names in asked:
        outcome = cli(command[0], *names, *command[1:], "-f", "csv", "--jobs", jobs)
        rows = outcome.rows
        for row in rows:
            row.pop("ms_per_frame", None)
        # A slow machine reports its progress, too.
        said = [line for line in outcome.err.splitlines() if not re.match(r"svmdist: \w+: \d+ of", line)]
        found.append((rows, said))
    assert all(one == found[0] for one in found)
    assert found[0][0]


def test_a_bad_log_is_told_at_the_end_and_stops_nothing(cli, with_bad, folder):
    """Exit code 3, with the rows of all others; a log that is cut gives what it has."""
    outcome = cli("estimate", with_bad, "-f", "csv", "--jobs", "2", code=3)
    *_, last = outcome.err.splitlines()
    assert "frames measured (100.0%)\n" in outcome.err
    assert "left out: " in last
    assert "junk.mcap: is not a recording" in last
    good = [row for row in outcome.rows if row["recording"].startswith("log")]
    assert good == cli("estimate", folder, "-f", "csv").rows
    assert 0 < len([row for row in outcome.rows if row["recording"] == "cut"]) < 6


def test_where_nothing_can_be_measured_the_code_is_1(cli, tmp_path):
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_text("junk")
    outcome = cli("validate", tmp_path, code=1)
    assert outcome.out == ""
    assert outcome.err.count("left out: ") == 2
    assert outcome.err.endswith("svmdist: no recording could be used\n")
    assert cli("validate", tmp_path / "a.mcap", "--resume", tmp_path / "results", code=1).line


def test_a_log_that_is_named_twice_is_measured_once(cli, folder):
    twice = cli("estimate", folder, folder / "log1.mcap", "-f", "csv")
    assert twice.out == cli("estimate", folder, "-f", "csv").out


def test_the_summary_ranks_logs_and_groups_them(cli, with_bad, tmp_path):
    """What failed first, then what was lost; groups by metadata, and all together, count every frame once."""
    summary = tmp_path / "summary.csv"
    options = ("--summary", summary, "--group", "scenario")
    cli("estimate", with_bad, "-o", tmp_path / "a.csv", *options, code=3)
    rows = list(csv.DictReader(summary.read_text().splitlines()))
    logs, together = rows[:5], rows[5:]
    assert [row["recording"] for row in logs[:2]] == ["junk", "cut"]
    assert [row["state"] for row in logs] == ["failed", "loss", "ok", "ok", "ok"]
    assert [row["rank"] for row in logs] == ["1", "2", "3", "4", "5"]
    groups = {row["recording"]: int(row["frame_count"]) for row in together}
    assert groups["scenario=sweep"] == 4 + 5
    assert groups["overall"] == sum(int(row["frame_count"]) for row in logs)
    assert together[-1]["reason"] == "1 of 5 logs failed"


@pytest.mark.parametrize("command", ["validate", "compare", "estimate --summary {}/summary.csv"])
def test_a_group_by_what_no_log_has_is_warned_of(cli, folder, tmp_path, command):
    """Once, with the nearest key; keys that some log has are not named."""
    options = ("--method", "kinematic", "--jobs", 1, "--group", "scenari,seed")
    found = cli(*command.format(tmp_path).split(), folder, *options)
    assert found.err.count("--group") == 1
    assert "warning: --group scenari: no log has it: did you mean scenario? The choices are: " in found.err


@pytest.mark.slow
def test_groups_of_validate_and_compare(cli, folder):
    scores = cli("validate", folder, "-f", "csv", "--group", "scenario").rows
    frames = {(row["recording"], row["reference"]): int(row["frame_count"]) for row in scores}
    for reference in {row["reference"] for row in scores}:
        assert frames["scenario=sweep", reference] == frames["log0", reference] + frames["log1", reference]
        assert frames["scenario=approach", reference] == frames["log2", reference]
    compared = cli("compare", folder, "--method", "kinematic", "-f", "csv", "--group", "scenario,seed")
    found = [(row["group"], int(row["frame_count"])) for row in compared.rows]
    assert found == [
        ("scenario=sweep seed=0", 4),
        ("scenario=sweep seed=1", 5),
        ("scenario=approach seed=2", 6),
        ("all", 15),
    ]


def test_a_report_ranks_the_logs(cli, with_bad, tmp_path):
    pytest.importorskip("plotly", reason="the extra report is not installed")
    report = tmp_path / "a.html"
    cli("estimate", with_bad, "-o", report, code=3)
    page = report.read_text()
    assert page.index("sorted by severity, worst first") < page.index("junk") < page.index(">cut<")
    assert "distance-3" in page  # figures of four logs
