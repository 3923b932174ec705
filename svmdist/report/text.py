"""Text for a terminal or a spreadsheet, made safe: names in a file are not ours."""

from __future__ import annotations

import unicodedata

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str) -> str:
    """Replace control, format and surrogate characters, which could drive a terminal, by U+FFFD."""
    return "".join("\N{REPLACEMENT CHARACTER}" if _is_unsafe(character) else character for character in text)


def counted(count: int, noun: str) -> str:
    """A count with its noun: `1 recording`, `2 recordings`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def csv_text(text: str) -> str:
    """Make a text cell that no spreadsheet takes for a formula."""
    text = printable(text)
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def _is_unsafe(character: str) -> bool:
    # Cc: control, such as ESC; Cf: format, such as the bidirectional overrides; Zl, Zp: line breaks.
    return unicodedata.category(character) in {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}
