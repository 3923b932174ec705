"""The documentation against the program: what it shows is what is measured, what it names exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "[!.]*/README.md")  # a run leaves .pytest_cache/README.md behind
    for path in REPOSITORY.glob(pattern)
)


def test_readme_example_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The ten lines of Python in the README run as they stand, and end with the statistics."""
    monkeypatch.chdir(REPOSITORY)
    (code,) = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text("utf-8"), re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 81
    assert " ok 0.0" in lines[0]
    assert lines[-1].startswith("ErrorStatistics(count=80")


def _tables(text: str) -> dict[str, list[list[str]]]:
    """The cells of each table's rows, by the heading above it."""
    tables: dict[str, list[list[str]]] = {}
    heading = ""
    for line in text.splitlines():
        if line.startswith("#"):
            heading = line.strip("# ")
        elif line.startswith("| "):
            tables.setdefault(heading, []).append([cell.strip() for cell in line.strip("|").split("|")])
    return tables


@pytest.mark.parametrize("folder", ["3d", "real"])
def test_tables_in_3d_agree_with_each_other_and_with_the_baseline(folder: str) -> None:
    """The README shows the first table of docs/results.md; there, the rows of `fused` are what the baseline stores."""
    from svmdist.workflows.baseline import load_baseline
    from tools.docs_3d import HEADER, LOGS, REAL_LOGS
    from tools.make_docs import MARKS_3D, MARKS_REAL

    (begin, end), logs_of = (MARKS_3D, LOGS) if folder == "3d" else (MARKS_REAL, REAL_LOGS)
    in_readme, in_results = (
        (REPOSITORY / name).read_text("utf-8").partition(begin)[2].partition(end)[0]
        for name in ("README.md", "docs/results.md")
    )
    tables = _tables(in_results)
    assert in_readme.lstrip().startswith(HEADER)
    assert _tables(in_readme)[""] == next(iter(tables.values()))
    stored = {
        score.recording: score
        for score in load_baseline(REPOSITORY / "recordings" / folder / "baseline.json").scores
    }
    (alarms,) = (rows for heading, rows in tables.items() if heading.startswith("Alarms"))
    assert {row[0] for row in alarms[1:]} == set(stored)
    for name, *_, safe_alarmed, _, _ in alarms[1:]:
        assert float(safe_alarmed.rstrip(" %")) == pytest.approx(
            100.0 * (stored[name].false_alarm_fraction or 0.0), abs=0.06
        )
    logs = [name for name in stored if not name.startswith("overall")]
    assert {name.split()[0] for name in logs} == {name.partition("/")[2] for name in logs_of}
    for name in logs:
        (fused,) = (row for row in tables[name] if row[0] == "`fused`")
        measured, frames = map(int, fused[1].split(" / "))
        assert measured / frames == stored[name].coverage
        for shown, kept_m in (
            (fused[2], stored[name].spatial_rmse_m),
            (fused[5], stored[name].clearance_rmse_m),
        ):
            assert float(shown) == pytest.approx(1e3 * (kept_m or 0.0), abs=0.0051)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_links_lead_somewhere(document: Path) -> None:
    """Every relative link of a document names a file that is there."""
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text("utf-8")):
        if "://" not in target:
            assert (document.parent / target).exists(), target


def test_every_command_is_in_the_readme() -> None:
    """Each subcommand has a row in the README's table, and the README names no other."""
    import typer

    from svmdist.cli.main import app

    commands = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    named = set(
        re.findall(r"^\| `svmdist ([\w-]+)", (REPOSITORY / "README.md").read_text("utf-8"), re.MULTILINE)
    )
    assert named == commands


def _named_in(document: str) -> set[str]:
    """What a document names in backticks, or as a key or table of an example."""
    text = (REPOSITORY / "docs" / document).read_text("utf-8")
    examples = "\n".join(re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    in_text = re.findall(r"`\[*([\w. ]+?)\]*`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    tables = re.findall(r"^\[+([\w.]+)\]+$", examples, re.MULTILINE)
    return {*in_text, *re.findall(r"(\w+) =", examples), *".".join(tables).split(".")}


def test_every_column_and_status_is_explained() -> None:
    """docs/output.md names each column of rows, scores and figures, and each reason, and no other reason."""
    from svmdist.report.comparison import compare_keys
    from svmdist.report.degradation_grid import grid_keys
    from svmdist.report.estimates import ESTIMATE_KEYS
    from svmdist.report.validation import score_keys
    from svmdist.samples import Status

    named = _named_in("output.md")
    assert {*ESTIMATE_KEYS, *score_keys(), *compare_keys(), *grid_keys(), *Status} - named == set()
    assert {name for name in named if re.match(r"no_|too_few", name)} <= set(Status)


def test_every_key_of_a_profile_is_explained() -> None:
    """docs/profile.md names each key of the tables that somebody writes for a scene of his own."""
    from svmdist.profile import (
        CameraError,
        Dome,
        Fiducial,
        HsvSegmentation,
        Instrument,
        Joint,
        KinematicError,
        OnnxSegmentation,
        OtherInstrument,
        Placement,
        Profile,
        Robot,
        Tissue,
    )

    tables = (Profile, HsvSegmentation, OnnxSegmentation, Robot, Joint, KinematicError, Instrument, Fiducial)
    named = _named_in("profile.md")
    for table in (*tables, CameraError, Tissue, Dome, OtherInstrument, Placement):
        assert set(table.model_fields) - named == set(), table.__name__


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_named_modules_exist(document: Path) -> None:
    """A path such as `vision/marker/pattern.py` in a document names a module of the package."""
    for path in re.findall(r"`(?:svmdist/)?((?:[a-z_]+/)*[a-z_]+\.py)`", document.read_text("utf-8")):
        folders = (REPOSITORY / "svmdist", REPOSITORY)
        there = any((folder / path).exists() for folder in folders)
        assert there or any((REPOSITORY / "tests").rglob(path)), path
