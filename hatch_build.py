"""The package page: its links and pictures lead to the repository, where its address is known.

A published README cannot have relative links. The address of the repository is given when the package is built:
`SVMDIST_URL=https://HOST/OWNER/svmdist uv build`. Without it the description has the text without pictures and links.
"""

from __future__ import annotations

import email
import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

PICTURE = re.compile(r"^!\[[^\]]*\]\((?!\w+://)([^)]+)\)\n+", re.MULTILINE)
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+://|#)([^)]+)\)")


def description(readme: str, url: str | None) -> str:
    """The README for the package page: relative links made absolute, or taken out where no address is known."""
    if url is None:
        return LINK.sub(r"\2", PICTURE.sub("", readme))
    return LINK.sub(lambda link: _absolute(link, url), readme)


def _absolute(link: re.Match[str], url: str) -> str:
    mark, text, target = link.groups()
    return f"{mark}[{text}]({url}/{'raw' if mark else 'blob'}/HEAD/{target})"


def urls(url: str | None) -> dict[str, str]:
    """The addresses of the project."""
    if url is None:
        return {}
    return {
        "Repository": url,
        "Documentation": f"{url}/blob/HEAD/docs/quick-start.md",
        "Changelog": f"{url}/blob/HEAD/CHANGELOG.md",
        "Issues": f"{url}/issues",
    }


class RepositoryAddress(MetadataHookInterface):
    """Fills in the description and the addresses of the project."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set `readme` and `urls`, which pyproject.toml declares as dynamic; an sdist has them already."""
        built = Path(self.root) / "PKG-INFO"
        if built.exists():
            page = email.message_from_string(built.read_text("utf-8"))
            metadata["readme"] = {"content-type": "text/markdown", "text": page.get_payload()}
            metadata["urls"] = dict(line.split(", ", 1) for line in page.get_all("Project-URL") or [])
            return
        url = os.environ.get("SVMDIST_URL", "").rstrip("/") or None
        if url is not None and not url.startswith("https://"):
            raise ValueError(f"SVMDIST_URL: expected an address that begins with https://, found {url}")
        text = (Path(self.root) / "README.md").read_text("utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": description(text, url)}
        metadata["urls"] = urls(url)
