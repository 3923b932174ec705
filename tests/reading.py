"""What tests read of a recording: every image, and what a method may see of each."""

from collections.abc import Iterator

from svmdist.recording.log import Recording
from svmdist.recording.observations import decode_image
from svmdist.recording.topics import Role
from svmdist.samples import ImageSample, Observation, Rejection


def read_observations(recording: Recording) -> Iterator[Observation | Rejection]:
    """What an estimator may see of the first instrument in every image, by stamp; errors come at once."""
    encoded = recording.encoded_observations()
    items = (recording.record_losses(one.decode()) for one in encoded)
    return (item if isinstance(item, Rejection) else item[0] for item in items)


def read_images(recording: Recording) -> Iterator[ImageSample | Rejection]:
    """Every image in file order, decoded; a Rejection stands for one that cannot be."""
    topic = recording.topic_of(Role.IMAGE)
    for image in recording.file.images({topic} if topic else ()):
        losses = []
        found = decode_image(image, losses)
        is_lost = isinstance(found, Rejection)
        yield found if is_lost else ImageSample(image.stamp_ns, image.frame_id, found)
        for loss in losses:
            recording.health.add(loss)
