"""Completion in a shell: the script that is shown is one, and what is typed is completed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.running import ended

NAMED_SHELL = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
"""Take the shell that is named: among the parents of a test there may be none to detect."""


def completed(words: str) -> list[str]:
    """What bash is offered for the last word, which may be empty."""
    typed = words.split(" ")
    done = ended(
        environment={
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(typed) - 1),
            "_SVMDIST_COMPLETE": "complete_bash",
        }
    )
    assert done.returncode == 0, done.stderr
    return str(done.stdout).split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_a_shell_completes_with_the_script_that_is_shown(tmp_path: Path) -> None:
    """bash reads the script, and its function asks a command of that name."""
    command = tmp_path / "svmdist"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m svmdist "$@"\n')
    command.chmod(0o755)
    script = str(ended("--show-completion", "bash", environment=NAMED_SHELL).stdout)
    assert "_svmdist_completion" in script
    ask = "\nCOMP_WORDS=(svmdist hand); COMP_CWORD=1; _svmdist_completion svmdist; echo ${COMPREPLY[@]}\n"
    done = subprocess.run(
        ["bash", "-c", script + ask],
        env={**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout.split() == ["hand-eye"], done.stderr
