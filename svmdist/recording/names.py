"""Names that come from a file, made safe to stand in one line of an error or a report."""

from __future__ import annotations

from collections.abc import Iterable

MAX_NAME_LENGTH = 300
MAX_LISTED_NAMES = 40
MAX_NAME_BYTES = 4096
"""Of a topic, a frame, a joint, a schema: longer ones are no names."""


def cut(text: str) -> str:
    """The beginning of a text that may be endless, to be kept or shown."""
    return text if len(text) <= MAX_NAME_LENGTH else f"{text[:MAX_NAME_LENGTH]}..."


def sanitize(name: str) -> str:
    r"""Write a name with its control characters escaped, shortened where it is endless.

    >>> sanitize("/left\x1b[31m")
    '/left\\x1b[31m'
    """
    shown = cut(name)
    if shown.isprintable():
        return shown
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in shown)


def sanitize_list(names: Iterable[str]) -> str:
    """List names, the first forty of them."""
    listed = [sanitize(name) for name in names]
    more = [f"and {len(listed) - MAX_LISTED_NAMES} more"] if len(listed) > MAX_LISTED_NAMES else []
    return ", ".join(listed[:MAX_LISTED_NAMES] + more)
