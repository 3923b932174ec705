"""Detections that are computed when a method first asks for them, kept for the others, and accounted for.

Several methods share the detections of a frame. What each of them cost is noted, so that a method's time can be told
as if it ran alone: its own steps, and every detection that it asked for, whoever asked first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")
Key = tuple[int, str]
Clock = Callable[[], float]


class CostLedger:
    """What the detections of one frame cost in s, each without those that it is made of.

    A frame is worked on by one thread at a time; `clock` is by default that thread's processor time, so that what
    other threads do meanwhile counts for nothing.
    """

    def __init__(self, clock: Clock = time.thread_time) -> None:
        self._clock = clock
        self._own_s: dict[Key, float] = {}
        self._parts: dict[Key, set[Key]] = {}
        self._open: list[tuple[set[Key], float]] = []

    def computed(self, key: Key, make: Callable[[], Value]) -> Value:
        """Compute a detection and note its cost."""
        self._open.append((set(), 0.0))
        start_s = self._clock()
        try:
            return make()
        finally:
            elapsed_s = self._clock() - start_s
            parts, inner_s = self._open.pop()
            self._own_s[key] = elapsed_s - inner_s
            self._parts[key] = {key}.union(*(self._parts[part] for part in parts))
            self._charge(key, elapsed_s)

    def used(self, key: Key) -> None:
        """Note that a detection was asked for which is known already."""
        self._charge(key, 0.0)

    def _charge(self, key: Key, elapsed_s: float) -> None:
        if self._open:
            asked, inner_s = self._open[-1]
            asked.add(key)
            self._open[-1] = asked, inner_s + elapsed_s

    @contextmanager
    def method(self, add_s: Callable[[float], None]) -> Any:
        """Tell what the steps inside cost, as if every detection had been computed for them."""
        self._open.append((set(), 0.0))
        start_s = self._clock()
        try:
            yield
        finally:
            elapsed_s = self._clock() - start_s
            asked, inner_s = self._open.pop()
            every = set[Key]().union(*(self._parts[key] for key in asked))
            add_s(elapsed_s - inner_s + sum(self._own_s[key] for key in every))


class detected(Generic[Value]):  # noqa: N801  (used as a decorator)
    """A property that is computed once an object, whose cost goes to the object's `ledger`."""

    def __init__(self, make: Callable[[Any], Value]) -> None:
        self._make = make
        self._name = make.__name__
        self.__doc__ = make.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> detected[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...

    def __get__(self, instance: Any, owner: type) -> Value | detected[Value]:
        """Give the value, computed now or before."""
        if instance is None:
            return self
        key = (id(instance), self._name)
        values: dict[str, Value] = instance.found
        if self._name in values:
            instance.ledger.used(key)
        else:
            values[self._name] = instance.ledger.computed(key, lambda: self._make(instance))
        return values[self._name]
