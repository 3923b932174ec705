"""Names out of a file: one printable line of bounded length, whatever they hold."""

from __future__ import annotations

import random

import pytest

from svmdist.recording.source import MAX_LISTED_NAMES, MAX_NAME_LENGTH, sanitize, sanitize_list

HOSTILE = {
    "escape sequence": "/left\x1b[31m",
    "line break": "/a\n/b\r",
    "zero": "/a\0b",
    "bidirectional override": "/\u202egnp",
    "lone surrogate": "/\ud800",
    "line separator": "/a\u2028b",
    "beyond the first plane": "/\U000e0001",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_what_is_not_printable_is_escaped(case: str) -> None:
    """The result is printable and can be written as UTF-8; what was printable is still there."""
    shown = sanitize(HOSTILE[case])
    assert shown.isprintable()
    assert shown.startswith("/")
    assert "\\" in shown
    assert shown.encode("utf-8")


@pytest.mark.parametrize(
    "name", ["", "/camera/left image", "/Ärzte", "/カメラ"], ids=["empty", "blank", "umlaut", "kana"]
)
def test_a_printable_name_stays_as_it_is(name: str) -> None:
    assert sanitize(name) == name
    assert sanitize(sanitize(name)) == sanitize(name)


def test_an_endless_name_is_shortened() -> None:
    """Up to the limit a name is whole; an escape takes at most ten characters for one."""
    assert sanitize("a" * MAX_NAME_LENGTH) == "a" * MAX_NAME_LENGTH
    assert sanitize("a" * 10**6) == "a" * MAX_NAME_LENGTH + "..."
    assert len(sanitize("\U000e0001" * 10**6)) == 10 * MAX_NAME_LENGTH + len("...")


def test_any_characters_give_one_line() -> None:
    """The law for names drawn from the whole of Unicode, surrogates among them."""
    rng = random.Random(3)
    for _ in range(300):
        name = "".join(chr(rng.randrange(0x110000)) for _ in range(rng.randrange(20)))
        assert sanitize(name).isprintable()


def test_a_list_names_the_first_and_counts_the_others() -> None:
    names = [f"/topic_{number}" for number in range(MAX_LISTED_NAMES)]
    assert sanitize_list(names) == ", ".join(names)
    assert sanitize_list(iter([*names, "/x", "/y"])) == ", ".join([*names, "and 2 more"])
    assert sanitize_list(["/a\n"]) == "/a\\n"
    assert sanitize_list([]) == ""
