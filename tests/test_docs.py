"""The documentation against the program: what it shows is what is measured, what it names exists."""

import inspect
import json
import re
from pathlib import Path

import pytest

from benchmarks.generated_pages import PAGES, table_in
from benchmarks.pictures import IMAGES, make_picture, printed_pictures
from benchmarks.real.ablate import CASES
from benchmarks.site_pages import OUTSIDE
from tests.conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "[!.]*/README.md")  # a run leaves .pytest_cache/README.md behind
    for path in REPOSITORY.glob(pattern)
)
MAX_WORDS = 20_000
DRAWN = (
    "factors.svg",
    "instrument.svg",
    "real.jpg",
)  # by hand; the last one as benchmarks/real/recode.py says


def _name(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def _rows(name: str) -> list[list[str]]:
    """The rows of a generated table of docs/results.md."""
    lines = table_in((DOCS / "results.md").read_text("utf-8"), name).splitlines()[2:]
    return [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines]


def _baseline(folder: str, reference: str = "ground_truth") -> dict[str, dict[str, float]]:
    """The stored figures of each golden log."""
    document = json.loads((REPOSITORY / "recordings" / folder / "baseline.json").read_text("utf-8"))
    return {score["recording"]: score for score in document["scores"] if score["reference"] == reference}


def _share(cell: str) -> float:
    """What `43 / 96` says."""
    part, _, whole = cell.partition("/")
    return int(part) / int(whole)


def test_planar_figures_are_those_of_the_baseline():
    """The rows of `overlay`, within the tolerance of the baseline, which holds what is measured to it."""
    stored = _baseline(".")
    rows = {row[0].split()[0]: row for row in _rows("golden-planar")}
    assert set(rows) == set(stored)
    for name, score in stored.items():
        _, frames, r_squared, rmse_mm, *_ = rows[name]
        assert _share(frames) == pytest.approx(score["coverage"])
        assert float(r_squared) == pytest.approx(score["r_squared"], abs=2e-3)
        assert float(rmse_mm) == pytest.approx(1e3 * score["rmse_m"], abs=0.02)


@pytest.mark.parametrize("folder", ["3d", "real"])
def test_figures_in_3d_are_those_of_the_baseline(folder):
    """The rows of `fused`, within the tolerance of the baseline, and no more false alarms."""
    stored = {name: score for name, score in _baseline(folder).items() if not name.startswith("overall")}
    rows = {row[0].removeprefix(f"{folder}/"): row for row in _rows("golden-fused") if row[0].startswith(f"{folder}/")}
    assert set(rows) - {"duo PSM1–PSM2"} == set(stored)
    for name, score in stored.items():
        _, frames, spatial_mm, _, clearance_mm, _, _, _, _, safe_alarmed, _ = rows[name]
        assert _share(frames) == pytest.approx(score["coverage"])
        assert float(spatial_mm) == pytest.approx(1e3 * score["spatial_rmse_m"], abs=0.02)
        assert float(clearance_mm) == pytest.approx(1e3 * score["clearance_rmse_m"], abs=0.02)
        assert float(safe_alarmed.rstrip("%")) <= 100 * score["false_alarm_fraction"] + 0.5


@pytest.mark.parametrize("name", PAGES)
def test_generated_parts_are_made_from_the_code(name):
    """After a change of columns, metrics, settings or perturbations: `uv run python -m benchmarks.generated_pages`."""
    text = (DOCS / name).read_text("utf-8")
    assert text == PAGES[name](text)


def _anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub and the documentation site make them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "") for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("document", DOCUMENTS, ids=_name)
def test_what_a_document_names_exists(document):
    """Every relative link names a file and a heading in it, and every path of a module a module."""
    text = document.read_text("utf-8")
    for target, anchor in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", text):
        if "://" not in target:
            file = document.parent / target if target else document
            assert file.exists(), target
            assert not anchor or anchor in _anchors(file), f"{target}#{anchor}"
    for path in re.findall(r"`((?:svmdist/)?(?:[a-z_]+/)*[a-z_]+\.py)`", text):
        assert (REPOSITORY / path).exists() or (REPOSITORY / "svmdist" / path).exists(), path


def test_documentation_stays_short_and_every_page_is_in_the_navigation():
    """README and docs/ have a limit of words; mkdocs.yml and the list of decisions name every page."""
    pages = {path.relative_to(DOCS).as_posix(): path for path in DOCS.rglob("*.md")}
    texts = [path.read_text("utf-8") for path in (REPOSITORY / "README.md", *pages.values())]
    assert sum(len(text.split()) for text in texts) <= MAX_WORDS
    decisions = sorted(page for page in pages if re.match(r"decisions/\d", page))
    in_navigation = re.findall(r": (\S+\.md)$", (REPOSITORY / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert sorted(in_navigation) == sorted({*pages, *OUTSIDE.values()} - {*decisions})
    index = pages["decisions/README.md"].read_text("utf-8")
    listed = re.findall(r"^\d+\. \[(.*)\]\((.*)\)$", index, re.MULTILINE)
    heads = [pages[page].read_text("utf-8").partition("\n")[0] for page in decisions]
    titles = [re.sub(r"^# \d+\. ", "", head) for head in heads]
    assert listed == [(title, Path(page).name) for title, page in zip(titles, decisions, strict=True)]


def test_every_picture_stands_above_the_commands_that_make_it():
    """No picture is left over, none is shown twice, and none but drawings without commands."""
    shown = [
        name
        for document in DOCUMENTS
        for name in re.findall(r"!\[[^\]]+\]\([^)]*images/([^)]+)\)", document.read_text("utf-8"))
    ]
    assert sorted(shown) == sorted({*printed_pictures(), *DRAWN})
    assert {path.name for path in IMAGES.iterdir()} == set(shown)


def test_a_picture_is_what_its_command_makes_now(tmp_path):
    """The picture of `overlay` as remade: the same panels, but for the digits."""
    import cv2
    import numpy as np

    make_picture("overlay.jpg", printed_pictures()["overlay.jpg"], tmp_path)
    kept, made = (cv2.imread(str(folder / "overlay.jpg")) for folder in (IMAGES, tmp_path))
    assert kept.shape == made.shape
    assert np.abs(kept.astype(np.int16) - made).mean() < 1.0


def test_the_architecture_names_every_package():
    text = (DOCS / "architecture.md").read_text("utf-8").partition("svmdist/\n")[2].partition("```")[0]
    folders = {path.parent.name for path in (REPOSITORY / "svmdist").glob("*/__init__.py")} | {
        "profiles",
        "models",
    }
    assert set(re.findall(r"^  (\w+)/ ", text, re.MULTILINE)) == folders


def test_every_command_is_in_the_readme():
    """The README names each subcommand in its section of what svmdist does."""
    import typer

    from svmdist.cli.main import app

    commands = set(typer.main.get_command(app).commands)
    text = (REPOSITORY / "README.md").read_text("utf-8")
    section = text.partition("## What it does")[2].partition("\n## ")[0]
    assert commands <= set(re.findall(r"`([\w-]+)[ `]", section)), "a command is missing"


def _named_in(document: str) -> set[str]:
    """What a document names in backticks, or as a key or table of an example."""
    text = (DOCS / document).read_text("utf-8")
    examples = "\n".join(re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    in_text = re.findall(r"`\[*([\w. ]+?)\]*`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    tables = re.findall(r"^\[+([\w.]+)\]+$", examples, re.MULTILINE)
    return {*in_text, *re.findall(r"(\w+) =", examples), *".".join(tables).split(".")}


def test_every_status_and_profile_key_is_explained():
    """docs/output.md names each status, and docs/profile.md each key that somebody writes for a scene of his own."""
    from svmdist.profile import Profile
    from svmdist.profile import robot as r
    from svmdist.profile import segmentation as s
    from svmdist.samples import Status

    named = _named_in("output.md")
    assert set(Status) <= named
    assert {name for name in named if re.match(r"no_|too_few", name)} <= set(Status)
    tables = (
        Profile,
        s.HsvSegmentation,
        s.OnnxSegmentation,
        r.Robot,
        r.Joint,
        r.KinematicError,
        r.Instrument,
    )
    for table in (*tables, r.Fiducial, r.CameraError, r.Tissue, r.Dome, r.OtherInstrument, r.Placement):
        assert set(table.model_fields) - _named_in("profile.md") == set(), table.__name__


def test_what_the_ablation_leaves_out_is_called_as_it_was():
    """It runs for an hour on images that are not here; a part that has changed since would end it."""
    for place, name, by in CASES.values():
        was = getattr(place, name)
        if callable(was):
            inspect.signature(by).bind(*inspect.signature(was).parameters)
