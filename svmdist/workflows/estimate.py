"""Estimate: a recording's observations through estimators, one estimate a frame and instrument."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from svmdist.estimation.between import with_clearance_between
from svmdist.estimation.identity.instruments import Instruments
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.methods import Estimator
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate, Observation, Rejection
from svmdist.workflows.setup import Setup


def estimate(recording: Recording, estimator: Estimator) -> Iterator[Estimate]:
    """Yield one estimate for each image of a recording, in order, holding one frame at a time.

    An image that cannot be decoded is an estimate with the status of its rejection.
    """
    for observation in recording.observations():
        if isinstance(observation, Rejection):
            yield Estimate(observation.stamp_ns, observation.status, detail=observation.detail)
        else:
            yield estimator.estimate(observation)


def estimate_instruments(
    recording: Recording, setup: Setup, wanted: Sequence[str] | None = None
) -> Iterator[Estimate]:
    """Yield for each image one estimate an instrument, in the order of the profile; each image is decoded once.

    `wanted` names some of the recording's instruments; the others are told apart from them, and not measured.
    Raises RecordingError at once for a name that the recording has no topics of.
    """
    names = recording.instruments if wanted is None else tuple(wanted)
    team = Team(recording, setup, names)
    return (row for found in recording.observations_of(recording.instruments) for row in team.measure(found))


def instruments_of(recording: Recording, setup: Setup) -> Instruments:
    """What tells the instruments of a recording apart."""
    profiles = [setup.profile.for_instrument(name) for name in recording.instruments]
    return Instruments(profiles, setup.segmenter)


class Team:
    """An estimator for each instrument of a recording, and what tells the instruments apart."""

    def __init__(self, recording: Recording, setup: Setup, wanted: Sequence[str] | None = None) -> None:
        self.names = recording.instruments if wanted is None else tuple(wanted)
        views = [recording.for_instrument(name) for name in self.names]
        self.estimators = [
            setup.estimator_for(view, name) for view, name in zip(views, self.names, strict=True)
        ]
        self._places = [recording.instruments.index(name) for name in self.names]
        self._models = [InstrumentModel.of(setup.profile.for_instrument(name)) for name in self.names]
        self._instruments = instruments_of(recording, setup)

    def tell_apart(self, observations: Sequence[Observation]) -> tuple[Observation, ...]:
        """What each of the wanted instruments may see of an image, of what every instrument reported."""
        told = self._instruments.tell_apart(observations)
        return tuple(told[place] for place in self._places)

    def measure(self, found: Sequence[Observation] | Rejection) -> list[Estimate]:
        """The rows of one image, one a wanted instrument."""
        if isinstance(found, Rejection):
            lost = Estimate(found.stamp_ns, found.status, detail=found.detail)
            return [replace(lost, instrument=name) for name in self.names]
        rows = [
            replace(estimator.estimate(observation), instrument=name)
            for name, estimator, observation in zip(
                self.names, self.estimators, self.tell_apart(found), strict=True
            )
        ]
        return self.finish(rows)

    def finish(self, rows: Sequence[Estimate]) -> list[Estimate]:
        """The rows of one image with the clearance between the instruments, and without what that was made of."""
        filled = with_clearance_between(rows, self._models) if len(rows) > 1 else rows
        return [replace(row, tool_state=None) for row in filled]
