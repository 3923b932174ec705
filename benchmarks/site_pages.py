"""Hook of mkdocs: pages of the repository that stand outside of docs/, and links between all of them.

Documents link to each other by their places in the repository, so that the links hold there. On the site README.md is
the first page; a link to a file that is no page of the site, such as a module, stays as text.
"""

from __future__ import annotations

import posixpath
import re
from itertools import cycle
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "recordings/README.md": "recordings.md",
    "schemas/README.md": "schemas.md",
}
"""Documents outside of docs/, by their place in the repository, and their place on the site."""
FOLDERS = {"schemas": "schemas.md", "recordings": "recordings.md", "docs/decisions": "decisions/README.md"}
"""What a link to a folder leads to."""
TABLE, TAG = re.compile(r"<table>.*?</table>", re.DOTALL), re.compile(r"<[^>]*>")
PICTURE = re.compile(r'(<img\b[^>]*\bsrc="([^"]+)"[^>]*>)')
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+:|#)([^)#\s]*)(#[^)\s]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the documents outside of docs/ to the site."""
    from mkdocs.structure.files import File

    for source, place in OUTSIDE.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text("utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, files: Any, **_: Any) -> str:
    """Make the links of a page lead to pages of the site."""
    place, pages = page.file.src_uri, {file.src_uri for file in files}
    of_page = {site: source for source, site in OUTSIDE.items()}
    folder = posixpath.dirname(of_page.get(place, f"docs/{place}"))

    def linked(link: re.Match[str]) -> str:
        mark, text, target, anchor = link.groups()
        source = posixpath.normpath(posixpath.join(folder, target))
        on_site = OUTSIDE.get(source) or FOLDERS.get(source) or source.removeprefix("docs/")
        if on_site not in pages:
            return text if (ROOT / source).exists() else link[0]
        relative = posixpath.relpath(on_site, posixpath.dirname(place) or ".")
        return f"{mark}[{text}]({relative}{anchor or ''})"

    fences = re.split(r"(^```.*?^```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if part.startswith("```") else LINK.sub(linked, part) for part in fences)


def on_page_content(html: str, **_: Any) -> str:
    """Link pictures to their full size, and name the column of each cell, which `site.css` shows on narrow screens."""

    def named(table: re.Match[str]) -> str:
        head, body = table[0].split("</thead>", 1)
        headings = [TAG.sub("", text).strip() for text in re.findall(r"<th\b[^>]*>(.*?)</th>", head, re.DOTALL)]
        names = cycle(headings)  # rows are as long as their table is wide
        return f"{head}</thead>" + re.sub("<td", lambda _: f'<td data-of="{next(names)}"', body)

    return TABLE.sub(named, PICTURE.sub(r'<a href="\2">\1</a>', html))
