"""What Python's parser of TOML cannot bear, found before it is asked: deep nesting, and integers without end."""

from __future__ import annotations

import re

MAX_DEPTH = 50
MAX_DIGITS = 1000
"""Python itself refuses to read more than 4,300; a number of 64 bits has 20."""
TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*|\d[\d_]*|[][{}\n]',
    re.DOTALL,
)
KEY = re.compile(r"[^=\n]*")
HEADER = re.compile(r"[ \t]*\[+([^]\n]*)\]+")


def find_excess(text: str) -> str | None:
    """Say in a few words where a document asks for too much: its line and key; None where it does not.

    Strings and comments are passed over. What is no TOML at all is left to the parser.
    """
    depth, line, statement, table = 0, 1, 0, ""
    position = 0
    while position < len(text):
        header = HEADER.match(text, position) if depth == 0 and position == statement else None
        if header is not None:
            table, position = header[1].strip(), header.end()
            continue
        found = TOKEN.search(text, position)
        if found is None:
            break
        token, position = found[0], found.end()
        line += token.count("\n")
        excess = None
        if token == "\n":
            if depth == 0:
                statement = position
        elif token in "[{":
            depth += 1
            excess = f"nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else None
        elif token in "]}":
            depth = max(depth - 1, 0)
        elif token[0].isdigit() and len(token) > MAX_DIGITS:
            excess = f"a number of more than {MAX_DIGITS} digits"
        if excess is not None:
            key = KEY.match(text, statement)
            return f"line {line}, key {_name(table, key[0] if key else '')}: {excess}"
    return None


def _name(table: str, key: str) -> str:
    name = ".".join(part for part in (table, key.strip()) if part)
    return name if len(name) <= 80 else f"{name[:77]}..."
