"""Frames of a video stream (foxglove.CompressedVideo, H.264), decoded in the order in which they were sent."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np

from svmdist.errors import RecordingError, optional_package
from svmdist.profile import Limits
from svmdist.recording.messages.images import ImageError, check_dimensions
from svmdist.recording.names import cut
from svmdist.samples import Image

NAL_UNIT = re.compile(rb"\x00\x00\x01(.)", re.DOTALL)
IDR_SLICE = 5
NEEDED_FOR = "an image in H.264"


class VideoDecoder:
    """Decodes one stream; each message is one frame in Annex B, without frames that refer to later ones.

    A frame refers to those before it, so that after a loss every picture would be wrong in places:
    nothing is delivered from there to the next key frame.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._codec: Any = None
        self._needs_key_frame = True
        self._count = 0
        self._loss_count = 0

    def decode(self, video_format: str, data: bytes, loss_count: int) -> Image:
        """Decode the next frame to BGR; ImageError where it cannot be, or must wait for a key frame.

        `loss_count` says how much was lost before this frame; when it has grown, frames may be missing.
        """
        needs_key_frame = self._needs_key_frame or loss_count != self._loss_count
        self._loss_count = loss_count
        self._needs_key_frame = True  # until this frame has come out whole
        if video_format != "h264":
            raise ImageError(f"video format {cut(video_format)!r} is not known; h264 is expected")
        if len(data) > self._limits.image_bytes:
            raise ImageError(f"{len(data)} bytes, the limit is {self._limits.image_bytes}")
        if needs_key_frame:
            if not any(match[1][0] & 0x1F == IDR_SLICE for match in NAL_UNIT.finditer(data)):
                raise ImageError("no key frame yet, which this frame refers to")
            self._codec = self._open()
        image = self._decode(data)
        self._needs_key_frame = False
        return image

    def _decode(self, data: bytes) -> Image:
        av = optional_package("av", "video", NEEDED_FOR, RecordingError)
        packet = av.Packet(data)
        packet.pts = self._count
        packet.time_base = Fraction(1, 1000)
        self._count += 1
        try:
            frames = self._codec.decode(packet)
        except (av.error.FFmpegError, ValueError, MemoryError) as problem:
            raise ImageError(f"the video does not decode: {problem}") from None
        if len(frames) != 1 or frames[0].is_corrupt or frames[0].pts != packet.pts:
            raise ImageError(f"the message holds {len(frames)} whole frames, one is expected")
        check_dimensions(frames[0].width, frames[0].height, self._limits)
        return np.asarray(frames[0].to_ndarray(format="bgr24"), np.uint8)

    def _open(self) -> Any:
        av = optional_package("av", "video", NEEDED_FOR, RecordingError)
        codec = av.CodecContext.create("h264", "r")
        codec.thread_count = 1  # threads hold frames back
        codec.flags |= av.codec.context.Flags.low_delay
        codec.options = {"max_pixels": str(self._limits.image_pixels), "err_detect": "explode"}
        return codec
