"""Showing: frames of a log as the methods see them, before anything is estimated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from svmdist.errors import UsageError
from svmdist.estimation.frame import Frame
from svmdist.estimation.scene import Arm, Scene
from svmdist.profile import AutoSegmentation
from svmdist.recording.log import Recording
from svmdist.recording.topics import Role
from svmdist.samples import Rejection
from svmdist.workflows.conditions import CLEAN
from svmdist.workflows.replay import adapted_segmenters
from svmdist.workflows.request import Setup


@dataclass(frozen=True)
class ShownFrame:
    """One image of a log, its number from 0, and a frame for each instrument; `scene` computes when it is asked."""

    number: int
    seconds: float
    scene: Scene
    frames: tuple[Frame, ...]

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.scene.observation.stamp_ns


Chosen = Callable[[int, float], bool]
"""Whether a frame is wanted, by its number and by its seconds since the first one."""


def shown_frames(
    recording: Recording, setup: Setup, chosen: Chosen, last: int | None = None
) -> Iterator[ShownFrame]:
    """Yield the chosen frames of a log that can be read, in order; those after number `last` are not looked at.

    Instruments are told apart as a replay does, which looks at every image before the chosen ones too.
    """
    (segmenter,) = adapted_segmenters(setup.segmenter, recording, [CLEAN])
    arms = [Arm(setup.profile.for_instrument(name)) for name in recording.instruments]
    association = None
    if len(arms) > 1 or isinstance(setup.profile.segmentation, AutoSegmentation):
        from svmdist.estimation.association import Association

        association = Association(arms)
    first_ns: int | None = None
    for number, encoded in enumerate(recording.encoded_observations(recording.instruments)):
        if last is not None and number > last:
            return
        first_ns = encoded.stamp_ns if first_ns is None else first_ns
        seconds = (encoded.stamp_ns - first_ns) * 1e-9
        wanted = chosen(number, seconds)
        if not wanted and association is None:
            continue
        found = recording.record_losses(encoded.decode())
        if isinstance(found, Rejection):
            continue
        scene = Scene(found[0], setup.profile, segmenter)
        if association is not None:
            frames = association.frames(scene, found)
        else:
            frames = [Frame.of(scene, arms[0], found[0], arms[0].state_at(found[0]))]
        if wanted:
            yield ShownFrame(number, seconds, scene, tuple(frames))


def image_stamps_ns(recording: Recording) -> list[int]:
    """The stamp of every image of a log, in file order; raises UsageError for a log without one."""
    from svmdist.recording.observations import LEFT_IMAGES

    stamps = [one.stamp_ns for one in recording.encoded_observations(recording.instruments[:1], LEFT_IMAGES)]
    if not stamps:
        raise UsageError(f"{recording.path.name}: no image on {recording.topic_of(Role.IMAGE)} can be read")
    return stamps


def spread(count: int, wanted: int) -> Sequence[int]:
    """At most `wanted` of the numbers below `count`, evenly apart, the first one among them."""
    if count <= wanted:
        return range(count)
    return [round(at * (count - 1) / (wanted - 1)) for at in range(wanted)] if wanted > 1 else [0]
