"""Observations whose images are still encoded: read in one thread, decoded in any."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.camera import Camera
from svmdist.recording.health import Loss, LossKind
from svmdist.recording.messages.checks import EncodedImage
from svmdist.recording.messages.images import ImageError
from svmdist.recording.pairing import LoggedImage, Matched
from svmdist.samples import Image, ImageSample, Observation, Rejection, RightView, Status
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Needs:
    """What a method uses of a log beside the left images; what it does not use is not kept nor decoded.

    Joints and transforms are checked in any case: a message of them that is broken is a loss. Images of the
    right camera are read only where they are needed.
    """

    joints: bool = True
    transforms: bool = True
    right: bool = True


EVERYTHING = Needs()
LEFT_IMAGES = Needs(joints=False, transforms=False, right=False)


@dataclass(frozen=True, slots=True)
class RightCamera:
    """The topic of right images, their camera, and where it stands: `T_left_right`, shape (4, 4)."""

    topic: str
    camera: Camera
    T_left_right: Array


@dataclass(frozen=True, slots=True)
class Decoded:
    """An observation of each instrument, or why there is none, and what was lost of the images.

    `place` orders the losses among those of the whole recording.
    """

    found: tuple[Observation, ...] | Rejection
    losses: tuple[Loss, ...] = ()
    place: int = 0


@dataclass(frozen=True, slots=True)
class EncodedObservation:
    """One image with what belongs to it, as it stands in the log; make it with `Recording.encoded_observations`.

    `decode` gives the same whatever the thread and whatever the order, and changes nothing: a caller decodes each
    observation once, and hands the results to `Recording.record_losses`.
    """

    matched: Matched
    camera: Camera
    topic: str
    right: RightCamera | None
    place: int

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.matched.logged.image.stamp_ns

    @property
    def size_bytes(self) -> int:
        """How much the encoded images hold in memory."""
        right = self.matched.right
        return self.matched.logged.size_bytes + (0 if right is None else right.size_bytes)

    def decode(self) -> Decoded:
        """Decode the images; a Rejection stands for a left image that cannot be, or has not its camera's size."""
        losses: list[Loss] = []
        image = decode_image(self.matched.logged, self.topic, losses)
        if isinstance(image, Rejection):
            return Decoded(image, tuple(losses), self.place)
        if _has_other_size(image.image_bgr, self.camera):
            height_px, width_px = image.image_bgr.shape[:2]
            detail = (
                f"{width_px}x{height_px} px; the camera has {self.camera.width_px}x{self.camera.height_px}"
            )
            losses.append(Loss(LossKind.IMAGE, detail, self.matched.logged.offset, self.topic))
            rejection = Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, detail)
            return Decoded(rejection, tuple(losses), self.place)
        view = self._right_view(losses)
        found = tuple(
            Observation(
                image.stamp_ns,
                image.image_bgr,
                self.camera,
                arm.joints,
                view,
                arm.T_camera_base,
                arm.joint_track,
            )
            for arm in self.matched.arms
        )
        return Decoded(found, tuple(losses), self.place)

    def _right_view(self, losses: list[Loss]) -> RightView | None:
        if self.right is None or self.matched.right is None:
            return None
        image = decode_image(self.matched.right, self.right.topic, losses)
        if isinstance(image, Rejection) or _has_other_size(image.image_bgr, self.right.camera):
            return None
        delay_s = (image.stamp_ns - self.stamp_ns) * 1e-9
        return RightView(image.image_bgr, self.right.camera, self.right.T_left_right, delay_s)


def decode_image(logged: LoggedImage, topic: str, losses: list[Loss]) -> ImageSample | Rejection:
    """Decode an image; one that cannot be is a rejection, and joins the losses."""
    image = logged.image
    try:
        return ImageSample(image.stamp_ns, image.frame_id, image.decode())
    except ImageError as problem:
        losses.append(Loss(LossKind.IMAGE, str(problem), logged.offset, topic))
        return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))


def decode_in_order(image: EncodedImage) -> EncodedImage:
    """Decode a frame of a video at once, so that any thread may ask for its pixels; other images stay as they are."""
    if not image.is_ordered:
        return image
    try:
        pixels: Image | ImageError = image.decode()
    except ImageError as problem:
        pixels = problem

    def give() -> Image:
        if isinstance(pixels, ImageError):
            raise ImageError(str(pixels))
        return pixels

    return EncodedImage(image.stamp_ns, image.frame_id, give)


def _has_other_size(image_bgr: Image, camera: Camera) -> bool:
    return image_bgr.shape[:2] != (camera.height_px, camera.width_px)
