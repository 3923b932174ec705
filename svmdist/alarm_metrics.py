"""Alarms in, numbers out: how alarms fare against the true clearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.transforms import Array

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AlarmStatistics:
    """How alarms fare against truth: counts, and figures that are None where nothing could show them.

    A frame is unsafe where its true clearance is below the threshold. `unjudged_count` of the frames had no
    clearance to judge, so that no alarm was raised. `lead_times_s` holds, for each time the truth falls below
    the threshold, how long before it the alarm was raised without a break, over safe frames; negative where it
    came late, and nothing for one that was missed.
    """

    frame_count: int
    unsafe_count: int
    true_alarm_count: int
    false_alarm_count: int
    unjudged_count: int
    false_alarm_episode_count: int
    duration_s: float
    event_count: int
    lead_times_s: tuple[float, ...]

    @property
    def precision(self) -> float | None:
        """Share of the alarmed frames that were unsafe."""
        return _share(self.true_alarm_count, self.true_alarm_count + self.false_alarm_count)

    @property
    def recall(self) -> float | None:
        """Share of the unsafe frames that were alarmed."""
        return _share(self.true_alarm_count, self.unsafe_count)

    @property
    def false_alarm_fraction(self) -> float | None:
        """Share of the safe frames that were alarmed."""
        return _share(self.false_alarm_count, self.frame_count - self.unsafe_count)

    @property
    def false_alarms_per_minute(self) -> float | None:
        """Stretches of alarmed frames without any unsafe frame, per minute of recording."""
        return self.false_alarm_episode_count * 60.0 / self.duration_s if self.duration_s > 0.0 else None

    @property
    def missed_event_count(self) -> int:
        """Events in which no alarm was raised at all."""
        return self.event_count - len(self.lead_times_s)

    @property
    def median_lead_s(self) -> float | None:
        """The lead time of the middle event."""
        return float(np.median(self.lead_times_s)) if self.lead_times_s else None

    @property
    def min_lead_s(self) -> float | None:
        """The shortest lead time; negative where an alarm came late."""
        return min(self.lead_times_s, default=None)


def alarm_statistics(
    stamps_s: ArrayLike,
    alarms: ArrayLike,
    clearance_m: ArrayLike,
    below_m: float,
    judged: ArrayLike | None = None,
) -> AlarmStatistics:
    """Score alarms, bool of shape (n,) at sorted stamps in s, against the true clearance in m, shape (n,).

    `judged`, bool of shape (n,), says which frames had a clearance to judge; all where None.

    A false alarm is an unbroken stretch of alarmed frames none of which is unsafe: an alarm that leads into an
    unsafe stretch is a timely one, although its safe frames count as alarmed ones. An event is an unbroken
    stretch of unsafe frames that begins inside the recording.
    """
    t, a, c = (
        np.asarray(stamps_s, np.float64),
        np.asarray(alarms, np.bool_),
        np.asarray(clearance_m, np.float64),
    )
    known = np.ones(a.shape, np.bool_) if judged is None else np.asarray(judged, np.bool_)
    if not t.shape == a.shape == c.shape == known.shape or t.ndim != 1:
        raise ValueError(
            f"expected arrays of the same shape (n,), found {t.shape}, {a.shape}, {c.shape} and {known.shape}"
        )
    unsafe = c < below_m
    false = a & ~unsafe
    events = [index for index in range(1, len(t)) if unsafe[index] and not unsafe[index - 1]]
    leads = [_lead_time_s(t, a, unsafe, event) for event in events]
    return AlarmStatistics(
        frame_count=len(t),
        unsafe_count=int(np.count_nonzero(unsafe)),
        true_alarm_count=int(np.count_nonzero(a & unsafe)),
        false_alarm_count=int(np.count_nonzero(false)),
        unjudged_count=int(np.count_nonzero(~known)),
        false_alarm_episode_count=_false_episode_count(a, unsafe),
        duration_s=float(t[-1] - t[0]) if len(t) else 0.0,
        event_count=len(events),
        lead_times_s=tuple(lead for lead in leads if lead is not None),
    )


def pooled_alarms(parts: Sequence[AlarmStatistics]) -> AlarmStatistics:
    """The statistics of several recordings together: counts and durations add up."""
    return AlarmStatistics(
        frame_count=sum(part.frame_count for part in parts),
        unsafe_count=sum(part.unsafe_count for part in parts),
        true_alarm_count=sum(part.true_alarm_count for part in parts),
        false_alarm_count=sum(part.false_alarm_count for part in parts),
        unjudged_count=sum(part.unjudged_count for part in parts),
        false_alarm_episode_count=sum(part.false_alarm_episode_count for part in parts),
        duration_s=sum(part.duration_s for part in parts),
        event_count=sum(part.event_count for part in parts),
        lead_times_s=tuple(lead for part in parts for lead in part.lead_times_s),
    )


def _share(count: int, of: int) -> float | None:
    return count / of if of else None


def _false_episode_count(alarms: Mask, unsafe: Mask) -> int:
    """Unbroken stretches of alarms without an unsafe frame."""
    begins = alarms & ~np.concatenate([[False], alarms[:-1]])
    episode = np.cumsum(begins)
    return int(np.count_nonzero(begins)) - len(np.unique(episode[alarms & unsafe]))


def _lead_time_s(t: Array, alarms: Mask, unsafe: Mask, event: int) -> float | None:
    """How long before an event its alarm began; None where none came while it lasted."""
    if alarms[event]:
        first = event
        while first > 0 and alarms[first - 1] and not unsafe[first - 1]:
            first -= 1
        return float(t[event] - t[first])
    for index in range(event, len(t)):
        if not unsafe[index]:
            return None
        if alarms[index]:
            return float(t[event] - t[index])
    return None
