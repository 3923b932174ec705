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
    from benchmarks.docs_3d import HEADER, LOGS, REAL_LOGS
    from benchmarks.golden_tables import MARKS_3D, MARKS_REAL
    from svmdist.workflows.scoring.baseline import load_baseline

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


def _anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub and the documentation site make them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "") for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_links_lead_somewhere(document: Path) -> None:
    """Every relative link of a document names a file that is there, and its anchor a heading in that file."""
    for target, anchor in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", document.read_text("utf-8")):
        if "://" in target:
            continue
        file = document.parent / target if target else document
        assert file.exists(), target
        if anchor:
            assert anchor in _anchors(file), f"{target}#{anchor}"


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    """mkdocs.yml names every page but the decisions, whose own page names each of them."""
    from benchmarks.site_pages import OUTSIDE

    pages = {path.relative_to(REPOSITORY / "docs").as_posix() for path in (REPOSITORY / "docs").rglob("*.md")}
    decisions = {page for page in pages if re.match(r"decisions/\d", page)}
    in_navigation = re.findall(r": (\S+\.md)$", (REPOSITORY / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert sorted(in_navigation) == sorted({*pages - decisions, *OUTSIDE.values()})
    index = (REPOSITORY / "docs" / "decisions" / "README.md").read_text("utf-8")
    listed = re.findall(r"^- \[(.*)\]\((.*)\)$", index, re.MULTILINE)
    titles = [
        ((REPOSITORY / "docs" / page).read_text("utf-8").partition("\n")[0].removeprefix("# "), page)
        for page in sorted(decisions)
    ]
    assert [(title, f"decisions/{name}") for title, name in listed] == titles


def test_links_of_the_site_lead_to_its_pages() -> None:
    """Links between documents follow them to their places on the site; a file that is no page stays as text."""
    from benchmarks.site_pages import site_links

    pages = {
        "index.md",
        "guide.md",
        "recordings.md",
        "changelog.md",
        "decisions/README.md",
        "images/scene.jpg",
    }
    for place, markdown, expected in (
        ("index.md", "![a](docs/images/scene.jpg)", "![a](images/scene.jpg)"),
        ("index.md", "[b](docs/guide.md#x)", "[b](guide.md#x)"),
        ("guide.md", "[c](../recordings/README.md)", "[c](recordings.md)"),
        ("recordings.md", "[d](../docs/guide.md)", "[d](guide.md)"),
        ("decisions/0001.md", "[e](../guide.md) [f](../../README.md)", "[e](../guide.md) [f](../index.md)"),
        ("guide.md", "[g](decisions/)", "[g](decisions/README.md)"),
        ("guide.md", "[h](../pyproject.toml)", "h"),
        ("guide.md", "[i](nowhere.md)", "[i](nowhere.md)"),
        ("guide.md", "[j](https://example.org) [k](#here)", "[j](https://example.org) [k](#here)"),
        ("guide.md", "```\n[l](../README.md)\n```\n", "```\n[l](../README.md)\n```\n"),
    ):
        assert site_links(markdown, place, pages) == expected


def test_figures_in_sentences_are_those_of_the_results() -> None:
    """What pages of methods tell of the golden logs in words is what docs/results.md has in its tables."""
    tables = _tables((REPOSITORY / "docs" / "results.md").read_text("utf-8"))
    instruments, fiducial = (
        (REPOSITORY / "docs" / "method" / f"{name}.md").read_text("utf-8")
        for name in ("instruments", "fiducial")
    )
    between = tables["Between PSM1 and PSM2 in `duo`, `fused`"][1]
    assert f"On the golden `duo` log it errs by {between[1]} mm" in instruments
    assert between[3] == "100 %"
    measured = tables["All methods in 3D, both logs and all instruments"][1]
    assert measured[0] == "`fiducial`"
    assert f"{measured[1].replace('/', 'of')} frames are measured" in fiducial
    results = (REPOSITORY / "docs" / "results.md").read_text("utf-8")
    ideal = results.partition("### Alarms of `fused`")[2].partition("### ")[0]
    (share,) = re.findall(r"^\| overall \|(?: [^|]+ \|){3} ([\d.]+ %) \|", ideal, re.MULTILINE)
    assert f"{share} of the safe frames are alarmed" in " ".join(results.split())


def test_pictures_are_made_by_the_commands_beside_them() -> None:
    """Each picture has its commands, and each page that shows it prints them; no picture is left over."""
    from benchmarks.pictures import IMAGES, PICTURES

    assert {path.name for path in IMAGES.iterdir()} == {*PICTURES, "instrument.svg"}
    shown = set()
    for document in DOCUMENTS:
        text = document.read_text("utf-8")
        for name in re.findall(r"!\[[^\]]+\]\([^)]*images/([^)]+\.(?:jpg|png))\)", text):
            shown.add(name)
            for command in PICTURES[name]:
                assert f"$ uv run {command}\n" in text, (document, command)
    assert shown == set(PICTURES)


def test_a_picture_is_what_its_command_makes_now(tmp_path: Path) -> None:
    """The picture of `overlay` as remade: the same panels, but for the digits."""
    import cv2
    import numpy as np

    from benchmarks.pictures import IMAGES, make_picture

    make_picture("overlay.jpg", tmp_path)
    kept, made = (cv2.imread(str(folder / "overlay.jpg")) for folder in (IMAGES, tmp_path))
    assert kept is not None
    assert made is not None
    assert kept.shape == made.shape
    assert np.abs(kept.astype(np.int16) - made).mean() < 1.0


def test_the_architecture_names_every_package() -> None:
    """The tree of docs/architecture.md has every folder of modules, and every folder that it has exists."""
    text = (REPOSITORY / "docs" / "architecture.md").read_text("utf-8")
    tree = re.findall(r"^svmdist/\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[0]
    named, parents = set(), [""]
    for indent, name in re.findall(r"^( +)(\w+)/ ", tree, re.MULTILINE):
        level = len(indent) // 2
        parents[level:] = [f"{parents[level - 1]}{name}/"]
        named.add(parents[level])
    packages = {
        f"{path.parent.relative_to(REPOSITORY / 'svmdist').as_posix()}/"
        for path in (REPOSITORY / "svmdist").rglob("__init__.py")
    }
    assert named == packages - {"./"} | {"profiles/"}


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


def test_every_status_is_explained() -> None:
    """docs/output.md names each reason, and no other; the columns are in docs/metrics.md."""
    from svmdist.samples import Status

    named = _named_in("output.md")
    assert {*Status} - named == set()
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
