"""How the rows of a log ended: statuses, outliers by detection, and alarms, as commands say them last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from svmdist.estimation.alarms import AlarmRules
from svmdist.results import AlarmEvent, FrameResult
from svmdist.samples import Status

MAX_REMARKS = 6  # lines


@dataclass
class Ending:
    """Counts over the rows of a log, and its alarms."""

    tally: dict[str, Counter[str]] = field(default_factory=dict)  # by status and detail, as these first came
    seen: Counter[str] = field(default_factory=Counter)  # rows in which a detection was measured,
    refused: Counter[str] = field(default_factory=Counter)  # and in which it contradicted the rest
    events: dict[str, dict[int, AlarmEvent]] = field(default_factory=dict)  # by instrument and first image
    remarks: list[str] = field(default_factory=list)  # on the recording
    least: FrameResult | None = None  # the row of the smallest clearance

    @classmethod
    def of(cls, rows: Iterable[FrameResult], remarks: Iterable[str] = ()) -> Ending:
        """The ending of all rows of a log, and what is remarked on it."""
        ending = cls(remarks=list(remarks))
        for row in rows:
            ending.add(row)
        return ending

    def add(self, row: FrameResult) -> None:
        """Count a row."""
        self.tally.setdefault(str(row.status), Counter())[row.detail] += 1
        least = None if self.least is None else self.least.distances.clearance
        found = row.distances.clearance if row.measured else None
        if found is not None and (least is None or found.value_m < least.value_m):
            self.least = row
        self.seen.update((*row.accepted, *row.refused))
        self.refused.update(row.refused)
        events = self.events.setdefault(row.instrument, {})
        if (event := row.alarm.event) is not None:
            events[event.start_number] = event

    @property
    def alarms(self) -> list[AlarmEvent]:
        """The alarms of all instruments in the order of time."""
        every = (event for events in self.events.values() for event in events.values())
        return sorted(every, key=lambda event: event.start_s)

    @property
    def least_in_words(self) -> str:
        """The smallest clearance, with its interval, and where it is; raises ValueError without any."""
        if self.least is None or (clearance := self.least.distances.clearance) is None:
            raise ValueError("no clearance was measured")
        half = "" if clearance.half_m is None else f" ± {clearance.half_m * 1e3:.2f}"
        return (
            f"smallest clearance {clearance.value_m * 1e3:z.2f}{half} mm at {self.least.seconds:.2f} s"
            f" (frame {self.least.number}, {self.least.instrument})"
        )

    @property
    def statuses(self) -> dict[str, int]:
        """The counts by status."""
        return {status: details.total() for status, details in self.tally.items()}


def refusals_in_words(endings: Iterable[Ending]) -> Iterator[str]:
    """One text for each detection that was refused anywhere, the most refused one first."""
    seen, refused = Counter[str](), Counter[str]()
    for one in endings:
        seen.update(one.seen)
        refused.update(one.refused)
    # It contradicts those that were refused in less than half of their rows, and nominal kinematics else.
    inliers = [name for name in seen if 2 * refused[name] < seen[name]]
    for name, count in refused.most_common():
        others = [one for one in inliers if one != name] or ["the joints"]
        listed = " and ".join(filter(None, (", ".join(others[:-1]), others[-1])))
        yield f"{name} refused in {count} of {seen[name]} frames: it contradicts {listed}"


def remarks_in_words(endings: Mapping[str, Ending]) -> Iterator[str]:
    """What is remarked on logs, by log; of many logs the first few."""
    every = [(log, line) for log, one in endings.items() for line in one.remarks]
    for log, line in every[:MAX_REMARKS]:
        yield f"{log}: {line}" if len(endings) > 1 else line
    if more := {log for log, _ in every[MAX_REMARKS:]}:
        yield f"the like of {len(more)} more logs"


def alarms_in_words(endings: Mapping[str, Ending], rules: AlarmRules) -> str:
    """How many alarms logs had, and the first and the longest of them."""
    every = [(log, event) for log, one in endings.items() for event in one.alarms]
    instruments = {event.instrument for _, event in every}

    def where(log: str, event: AlarmEvent) -> str:
        names = [log] * (len(endings) > 1) + [event.instrument] * (len(instruments) > 1)
        return f"({' '.join(names)}{', ' * bool(names)}frame {event.start_number})"

    said = f"{len(every) or 'no'} alarm{'s' * (len(every) > 1)} ({rules.in_words})"
    if every:
        longest = max(every, key=lambda one: one[1].duration_s)
        said += f": first at {every[0][1].start_s:.2f} s {where(*every[0])}"
        said += f", longest {longest[1].duration_s:.2f} s {where(*longest)}"
    lost = (count for one in endings.values() for status, count in one.statuses.items() if status != Status.OK)
    if count := sum(lost):
        said += f"; {count} frames without a clearance raise none, which does not make them safe"
    return said
