"""Degradations on the command line: `NAME=SEVERITY`, lists of names and lists of severities."""

from __future__ import annotations

from svmdist.errors import UsageError


def parse_degradations(option: str, values: list[str] | None) -> tuple[tuple[str, int], ...]:
    """Parse NAME=SEVERITY values; raises UsageError. Name and range are checked where they are used."""
    parsed = []
    for value in values or []:
        name, _, severity = value.partition("=")
        if not (name and severity.isdecimal()):
            raise UsageError(f"{option} {value}: expected NAME=SEVERITY, as in smoke=3")
        parsed.append((name, int(severity)))
    return tuple(parsed)


def parse_names(option: str, text: str) -> list[str]:
    """Parse names that are separated by commas; raises UsageError for an empty name."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option} {text}: expected names separated by commas, as in smoke,noise")
    return names


def parse_severities(option: str, text: str) -> list[int]:
    """Parse whole numbers separated by commas; raises UsageError. Their range is checked where they are used."""
    numbers = [number.strip() for number in text.split(",")]
    if not all(number.isdecimal() for number in numbers):
        raise UsageError(
            f"{option} {text}: expected whole numbers from 1 to 5, separated by commas, as in 1,3,5"
        )
    return [int(number) for number in numbers]
