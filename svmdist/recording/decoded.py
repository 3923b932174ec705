"""Messages of a source as samples; those that cannot be decoded are counted as losses, and left out."""

from __future__ import annotations

from collections.abc import Iterator

from svmdist.profile import Limits
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.messages.checks import DecodeError, EncodedImage, RawTransforms
from svmdist.recording.messages.decoding import Decoder, Message
from svmdist.recording.sources import RawMessage, Source
from svmdist.samples import Sample

OTHER_JOINTS = "its joints are others than those of the first message"


class DecodedMessages:
    """What a source holds, decoded within limits; every call streams the file anew."""

    def __init__(self, source: Source, limits: Limits) -> None:
        self.source = source
        self.limits = limits

    @property
    def health(self) -> Health:
        """What was lost so far."""
        return self.source.health

    def samples(self, *topics: str) -> Iterator[tuple[RawMessage, Sample | EncodedImage]]:
        """Decode the messages of some topics; one that cannot be decoded is a loss."""
        decoder = Decoder(self.limits)
        for raw in self.source.messages(frozenset(topics)):
            message = self.read(decoder, raw)
            if message is not None:
                yield raw, message.to_sample() if isinstance(message, RawTransforms) else message

    def read(self, decoder: Decoder, raw: RawMessage) -> Message | None:
        """Read and check a message; None, and a loss, where it cannot be used."""
        try:
            return decoder.read(raw)
        except DecodeError as problem:
            self.record_loss(LossKind.MESSAGE, str(problem), raw)
            return None

    def record_loss(self, kind: LossKind, detail: str, raw: RawMessage) -> None:
        """Count a message as lost."""
        self.health.add(Loss(kind, detail, raw.offset, raw.topic))
