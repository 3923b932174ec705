"""Time stamps of imported images, in ns: from file names, from a table, or from a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

from svmdist.errors import SourceError

DECIMAL_STAMP = re.compile(r"(?<!\d)(\d{9,11})[._](\d{3,9})(?!\d)")
"""Seconds since 1970 and their fraction."""
WHOLE_STAMP = re.compile(r"(?<!\d)(\d{13,19})(?!\d)")
MAX_STAMP_NS = (1 << 63) - 1
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def parse_stamp_ns(text: str, unit: str | None = None) -> int:
    """A stamp in ns; without a unit (s, ms, us, ns) by its size, which tells them apart for times since 1970.

    Raises ValueError for text that is no number, and for a stamp that is negative or beyond 64 bits.
    """
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"expected a time, found {text[:40]!r}") from None
    if not value.is_finite():
        raise ValueError(f"expected a time, found {text[:40]!r}")
    if unit is None:
        unit = next(
            (name for name, least in (("ns", 10**17), ("us", 10**14), ("ms", 10**11)) if value >= least), "s"
        )
    stamp_ns = round(value * UNITS_NS[unit])
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise ValueError(f"a time must not be negative or beyond 64 bits of ns, found {text[:40]}")
    return stamp_ns


def stamps_from_names(names: Sequence[str]) -> list[int] | None:
    """The stamps in file names, `1479250744.250.png` in s or `1479250744250000000.png`; None where one has none."""
    stamps = []
    for name in names:
        stem = name.rpartition(".")[0] or name
        decimal = DECIMAL_STAMP.search(stem)
        whole = WHOLE_STAMP.search(stem)
        if decimal:
            stamps.append(int(decimal[1]) * 10**9 + int(decimal[2].ljust(9, "0")))
        elif whole:
            stamps.append(parse_stamp_ns(whole[1]))
        else:
            return None
    return stamps


def stamps_at_rate(count: int, rate_hz: float, start_ns: int) -> list[int]:
    """Stamps at a steady rate."""
    return [start_ns + round(number * 1e9 / rate_hz) for number in range(count)]


def require_rising(stamps_ns: Sequence[int], names: Sequence[str], what: str) -> None:
    """Raise SourceError where a stamp is not after the one before it."""
    for number in range(1, len(stamps_ns)):
        if stamps_ns[number] <= stamps_ns[number - 1]:
            raise SourceError(
                f"{what}: the time of {names[number]} ({stamps_ns[number]} ns) is not after that of"
                f" {names[number - 1]} ({stamps_ns[number - 1]} ns)"
            )
