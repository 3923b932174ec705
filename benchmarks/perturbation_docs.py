"""The table of perturbations in docs/simulation.md, made from the declared ones.

Run `uv run python -m benchmarks.perturbation_docs` after a change of them; a test holds the page against the code.
"""

from __future__ import annotations

from pathlib import Path

from svmdist.perturbations.table import TABLE, Perturbation

PAGE = Path(__file__).resolve().parent.parent / "docs" / "simulation.md"
MARKS = ("<!-- perturbations: begin -->\n", "<!-- perturbations: end -->\n")
HEADER = (
    "| name | unit | changes | meaning | range | `--world real` | source |\n|---|---|---|---|---|---|---|\n"
)


def perturbation_table() -> str:
    """One row a perturbation, in the order of the table."""
    return HEADER + "".join(_row(entry) for entry in TABLE.values())


def page_with_table(page: str) -> str:
    """The page with the table between its marks."""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not (begin and end):
        raise ValueError(f"{PAGE.name} has no place for the table: {MARKS[0].strip()}")
    return before + begin + perturbation_table() + end + after


def _row(entry: Perturbation) -> str:
    cells = (
        f"`{entry.name}`",
        entry.unit,
        str(entry.place),
        entry.meaning + ("" if entry.at_replay else " Recording only."),
        f"{entry.low:g} to {entry.high:g}",
        "–" if entry.real is None else str(entry.real),
        entry.source or "–",
    )
    return "| " + " | ".join(cells) + " |\n"


def main() -> None:
    """Write the table into the page."""
    PAGE.write_text(page_with_table(PAGE.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
