"""Degradations on the command line: `NAME=SEVERITY`, and lists of names and of severities."""

from __future__ import annotations

from svmdist.errors import UsageError


def parse_degradations(option: str, values: list[str] | None) -> tuple[tuple[str, int], ...]:
    """Parse NAME=SEVERITY values; raises UsageError. Whether the name exists is checked where it is used."""
    parsed = []
    for value in values or []:
        name, _, severity = value.partition("=")
        if not (name and severity.isdecimal()):
            raise UsageError(f"{option} {value}: expected NAME=SEVERITY, as in smoke=3")
        parsed.append((name, int(severity)))
    return tuple(parsed)


def parse_names(option: str, text: str) -> list[str]:
    """Parse a list with commas between; raises UsageError for an empty one."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option} {text}: expected names with commas between, as in smoke,noise")
    return names


def parse_severities(option: str, text: str) -> list[int]:
    """Parse whole numbers with commas between; raises UsageError. Their range is checked where they are used."""
    numbers = [number.strip() for number in text.split(",")]
    if not all(number.isdecimal() for number in numbers):
        raise UsageError(
            f"{option} {text}: expected whole numbers from 1 to 5 with commas between, as in 1,3,5"
        )
    return [int(number) for number in numbers]
