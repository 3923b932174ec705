"""Measurements of one kind from many frames as one stack, so that a batch linearises them at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.filter.measurement import LinkMeasurement


@dataclass(frozen=True, slots=True)
class MeasurementStack:
    """Measurements that differ in their numbers only: the stack of them, and where each of them is from.

    `frames` and `places`, shape (k,), are the frame's index and the place among the frame's measurements.
    """

    measurement: LinkMeasurement
    frames: NDArray[np.intp]
    places: NDArray[np.intp]


def stack(frames: Iterable[tuple[LinkMeasurement, ...]]) -> list[MeasurementStack]:
    """Sort the measurements of frames into stacks."""
    groups: dict[tuple[object, ...], list[tuple[LinkMeasurement, int, int]]] = {}
    for index, measurements in enumerate(frames):
        for place, measurement in enumerate(measurements):
            groups.setdefault(_kind(measurement), []).append((measurement, index, place))
    return [_join(members) for members in groups.values()]


def _kind(measurement: LinkMeasurement) -> tuple[object, ...]:
    """What must agree in a stack: the class, the shapes of what is stacked, and all that is no name."""
    key: list[object] = [type(measurement)]
    for field in fields(measurement):
        value = getattr(measurement, field.name)
        if field.name in measurement.STACKED:
            key.append(np.shape(value))
        elif field.name not in ("name", "bias_name"):
            # Strings and numbers are equal by value; a camera is the same one throughout a log.
            key.append(value if isinstance(value, str | int | float | tuple | None) else id(value))
    return tuple(key)


def _join(members: list[tuple[LinkMeasurement, int, int]]) -> MeasurementStack:
    measurements, frames, places = zip(*members, strict=True)
    first = measurements[0]
    stacked = {
        name: np.stack([np.asarray(getattr(measurement, name)) for measurement in measurements])
        for name in first.STACKED
    }
    joined: LinkMeasurement = replace(first, **stacked)
    return MeasurementStack(joined, np.array(frames), np.array(places))
