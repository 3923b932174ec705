"""Results as plain data: what is written is read as it was, and what is of another type is refused."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from svmdist.workflows.batch.plain import PlainError, from_plain, to_plain


class Colour(StrEnum):
    """One of each kind."""

    RED = "red"


@dataclass(frozen=True)
class Inner:
    """One of each kind."""

    name: str
    value: float | None = None


@dataclass(frozen=True)
class Outer:
    """One of each kind."""

    colour: Colour
    counts: dict[str, int]
    parts: tuple[Inner, ...]
    pair: tuple[int, str]
    kind: Literal["a", "b"]
    values: NDArray[np.float64]
    flags: list[bool]


OUTER = Outer(
    Colour.RED,
    {"x": 1},
    (Inner("a", np.nan), Inner("b", 0.1 + 0.2), Inner("c")),
    (7, "seven"),
    "b",
    np.array([[1.0, np.nan], [np.inf, -0.0]]),
    [True],
)


def test_what_is_written_is_read_to_the_last_bit() -> None:
    found = from_plain(Outer, json.loads(json.dumps(to_plain(OUTER))))
    assert found.values.tobytes() == OUTER.values.tobytes()
    assert found.values.shape == (2, 2)
    assert np.isnan(found.parts[0].value)
    assert (found.colour, found.counts, found.parts[1:], found.pair, found.kind, found.flags) == (
        OUTER.colour,
        OUTER.counts,
        OUTER.parts[1:],
        OUTER.pair,
        OUTER.kind,
        OUTER.flags,
    )


@pytest.mark.parametrize(
    "change",
    [
        {"colour": "blue"},
        {"counts": {"x": "1"}},
        {"counts": {"x": True}},
        {"parts": [{"name": "a"}]},
        {"parts": [{"name": "a", "value": None, "more": 1}]},
        {"pair": [7]},
        {"kind": "c"},
        {"values": {"dtype": "object", "shape": [1], "base64": "AAAA"}},
        {"values": {"dtype": "float64", "shape": [3], "base64": "AAAA"}},
        {"flags": [1]},
    ],
)
def test_what_is_of_another_type_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(PlainError):
        from_plain(Outer, to_plain(OUTER) | change)


def test_what_cannot_be_stored_is_refused() -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        to_plain(object())
