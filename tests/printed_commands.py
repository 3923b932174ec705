"""The shell commands that the documentation prints, as what bash makes of them."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests.conftest import REPOSITORY

SHELL_FENCE = re.compile(r"^```(console|bash|sh|shell)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RECORDER = "uv() { printf '%s\\0' \"$@\" $'\\x1e'; }"
"""Stands for the program `uv`: it prints its arguments, and runs nothing."""


@dataclass(frozen=True)
class Command:
    """One command as printed, which may continue on further lines, and where it stands."""

    document: str
    line: int
    text: str

    @property
    def place(self) -> str:
        """The document and the line, as editors read them."""
        return f"{self.document}:{self.line}"

    def calls(self, folder: Path) -> list[list[str]]:
        """What follows `uv` in each of its calls, with quotes, globs and loops as bash resolves them in a folder."""
        told = subprocess.run(
            ["bash", "-euc", f"{RECORDER}\n{self.text}"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        return [call.strip("\0").split("\0") for call in told.split("\x1e\0")[:-1]]


def commands_of(document: Path) -> list[Command]:
    """Every command of a document: a line that begins with `$ `, and the lines below it that do not."""
    text = document.read_text("utf-8")
    name = document.relative_to(REPOSITORY).as_posix()
    found = []
    for fence in SHELL_FENCE.finditer(text):
        first_line = text[: fence.start(2)].count("\n") + 1
        lines = fence[2].splitlines()
        starts = [number for number, line in enumerate(lines) if line.startswith("$ ")]
        if fence[1] != "console" or not starts or starts[0] != 0:
            raise ValueError(f"{name}:{first_line}: commands are printed as ```console, each behind `$ `")
        for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
            found.append(Command(name, first_line + start, "\n".join(lines[start:end])[2:]))
    return found
