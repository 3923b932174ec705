"""docs/settings.md, made from the settings themselves: every field with its default, its bounds and its meaning.

Run `uv run python -m benchmarks.settings_docs` after a change of a setting; a test holds the page against the code.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from itertools import pairwise
from pathlib import Path

from svmdist.profile.settings import Settings
from svmdist.profile.toml import StrictModel

PAGE = Path(__file__).resolve().parent.parent / "docs" / "settings.md"
HEAD = """# Settings

What detectors and estimators may assume, and how sure they are of it. The defaults serve most logs; a profile may set
any of them in a table `[settings.NAME]`, for example

```toml
[settings.shaft]
max_position_std_m = 0.006
```

A value outside its bounds, or a name that is not there, is told when the profile is read. Suffixes are units: `_m`,
`_px`, `_rad`, `_s`; what has none is a ratio or a count. This page is made by `benchmarks/settings_docs.py`.
"""
BOUNDS = {"Gt": ("gt", ">"), "Ge": ("ge", "≥"), "Lt": ("lt", "<"), "Le": ("le", "≤")}


def settings_page() -> str:
    """The whole page."""
    groups = Settings()
    return "\n".join([HEAD, *(_group(name, getattr(groups, name)) for name in Settings.model_fields)])


def meanings(group: type[StrictModel]) -> dict[str, str]:
    """The docstring below each field of a group, read from the source: programs that run have no need of them."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(group))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, below in pairwise(definition.body):
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_text:
            found[field.target.id] = _sentence(str(ast.literal_eval(below.value)))  # type: ignore[attr-defined]
    return found


def _group(name: str, group: StrictModel) -> str:
    lines = [f"## `[settings.{name}]`\n", f"{_sentence(type(group).__doc__ or '')}\n"]
    told = meanings(type(group))
    lines += ["| setting | default | bounds | meaning |", "|---|---|---|---|"]
    for key, field in type(group).model_fields.items():
        bounds = ", ".join(
            f"{sign} {getattr(mark, attribute):g}"
            for mark in field.metadata
            for attribute, sign in [BOUNDS.get(type(mark).__name__, ("", ""))]
            if attribute
        )
        lines.append(f"| `{key}` | {getattr(group, key)} | {bounds or '–'} | {told[key]} |")
    return "\n".join(lines) + "\n"


def _sentence(text: str) -> str:
    """A docstring in one line that a table can hold."""
    return " ".join(text.split()).replace("|", "\\|")


def main() -> None:
    """Write the page."""
    PAGE.write_text(settings_page(), "utf-8")


if __name__ == "__main__":
    main()
