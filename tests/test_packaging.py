"""What is published: the files of an sdist, the wheel that is made of it, and the page of the package."""

import email
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from email.message import Message
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY, unpack

URL = "https://example.org/somebody/svmdist"
TOP = {
    *("CHANGELOG.md", "LICENSE", "PKG-INFO", "README.md", "SECURITY.md", "docs", "hatch_build.py"),
    *("pyproject.toml", "schemas", "svmdist"),
}
SUFFIXES = {
    "docs": {".md", ".jpg", ".png", ".svg", ".json", ".css"},
    "schemas": {".md", ".proto"},
    "svmdist": {".py", ".toml", ".j2", ".js", ".css", ".onnx"},
}
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]


def build(kind: str, source: Path, folder: Path, url: str | None = None) -> Path:
    """Build an sdist or a wheel of a source tree."""
    environment = {name: value for name, value in os.environ.items() if name != "SVMDIST_URL"}
    if url is not None:
        environment["SVMDIST_URL"] = url
    command = [sys.executable, "-m", "hatchling", "build", "--target", kind, "--directory", str(folder)]
    subprocess.run(command, cwd=source, env=environment, check=True, capture_output=True)
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sdist, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    unpack(build("sdist", REPOSITORY, folder / "built"), folder / "unpacked")
    (root,) = (folder / "unpacked").iterdir()
    return root


def page(path: Path) -> Message:
    """The metadata of an unpacked sdist."""
    return email.message_from_string((path / "PKG-INFO").read_text("utf-8"))


def links(text: str) -> list[str]:
    """The targets of all links and pictures."""
    return re.findall(r"\]\(([^)]+)\)", text)


def test_an_sdist_has_what_it_needs_and_nothing_else(sdist):
    """The package, its schemas and its documentation: no recording, test, tool, cache or stray file."""
    found = {path.name for path in sdist.iterdir()} - {".gitignore"}
    assert found == TOP
    for folder, suffixes in SUFFIXES.items():
        files = [path for path in (sdist / folder).rglob("*") if path.is_file()]
        assert {path.suffix for path in files if path.name != "py.typed"} <= suffixes, folder
        assert not [path for path in files if "__pycache__" in path.parts]
    tracked = {path.relative_to(REPOSITORY) for path in (REPOSITORY / "svmdist").rglob("*.py")}
    assert {path.relative_to(sdist) for path in (sdist / "svmdist").rglob("*.py")} == tracked
    sizes = {path: path.stat().st_size for path in sdist.rglob("*") if path.is_file()}
    networks = {path: size for path, size in sizes.items() if path.suffix == ".onnx"}
    assert sum(networks.values()) <= 5_000_000
    assert sum(sizes.values()) - sum(networks.values()) < 6e6


def test_the_wheel_of_an_sdist_is_the_wheel_of_the_tree(sdist, tmp_path):
    """The same files either way, profiles and schemas among them; metadata that was given to the sdist stays."""
    names = []
    for number, source in enumerate((REPOSITORY, sdist)):
        with zipfile.ZipFile(build("wheel", source, tmp_path / str(number))) as wheel:
            names.append(sorted(wheel.namelist()))
    assert names[0] == names[1]
    assert {"svmdist/profiles/psm13.toml", "svmdist/py.typed"} <= set(names[0])
    assert any(name.startswith("svmdist/schemas/") for name in names[0])


def test_the_package_page_has_no_relative_link(sdist, tmp_path):
    """Without the repository's address the page is text alone; with it, every link and picture is absolute."""
    readme = (REPOSITORY / "README.md").read_text("utf-8")
    plain = page(sdist)
    assert "Project-URL" not in plain
    assert links(plain.get_payload()) == [target for target in links(readme) if "://" in target]
    assert "How far is a surgical instrument from the tissue" in plain.get_payload()

    unpack(build("sdist", REPOSITORY, tmp_path / "built", URL), tmp_path / "unpacked")
    (root,) = (tmp_path / "unpacked").iterdir()
    addressed = page(root)
    targets = links(addressed.get_payload())
    assert len(targets) == len(links(readme))
    assert all(target.startswith("https://") for target in targets)
    assert f"{URL}/raw/HEAD/docs/images/real.jpg" in targets
    assert f"Repository, {URL}" in (addressed.get_all("Project-URL") or [])
    with zipfile.ZipFile(build("wheel", root, tmp_path / "wheel")) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith("/METADATA"))
        metadata = email.message_from_bytes(wheel.read(name))
    assert metadata.get_all("Project-URL") == addressed.get_all("Project-URL")
    assert links(metadata.get_payload()) == targets


def test_every_extra_is_explained():
    """The README has a row for each extra, and for no other."""
    table = (REPOSITORY / "README.md").read_text("utf-8").partition("| extra |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == set(PROJECT["optional-dependencies"])
