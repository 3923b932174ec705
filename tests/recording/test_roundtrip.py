"""What is written is read again, to the last bit where the encoding allows it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from svmdist import samples
from svmdist.profile import Limits
from svmdist.recording.log import open_recording
from svmdist.recording.messages import Decoder, Message, to_sample
from svmdist.recording.own_messages_pb2 import DistanceEstimate, GroundTruthDistance
from svmdist.recording.source import RawMessage
from svmdist.recording.writer import EncodedSample, encode
from svmdist.transforms import make_transform, rotation_from_quaternion_xyzw
from tests.reading import read_observations

from .builders import CAMERA

SCHEMAS = Path(__file__).parents[2] / "schemas"
stamps = st.integers(0, 2**62)
names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)
lengths = st.floats(-1e3, 1e3)


def there_and_back(sample: samples.Sample) -> Any:
    """Encode and decode a sample."""
    return to_sample(decoded(encode(sample)))


def decoded(encoded: EncodedSample) -> Message:
    """Decode a message."""
    raw = RawMessage("/t", encoded.schema, "protobuf", encoded.stamp_ns, encoded.data)
    return Decoder(Limits()).decode(raw)


@st.composite
def rigid(draw: st.DrawFn) -> np.ndarray:
    """A rigid transform, shape (4, 4)."""
    q = draw(arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.01))
    return make_transform(rotation_from_quaternion_xyzw(q), draw(arrays(np.float64, 3, elements=lengths)))


@given(stamps, names, names, rigid())
def test_transforms_survive_to_rounding(stamp_ns, parent, child, T):
    one = samples.TransformSample(stamp_ns, parent, child, T)
    back = there_and_back(samples.TransformsSample(stamp_ns, (one, one)))
    assert [(b.stamp_ns, b.parent, b.child) for b in back.transforms] == [(stamp_ns, parent, child)] * 2
    np.testing.assert_allclose(back.transforms[1].T_parent_child, T, rtol=0, atol=1e-14)
    pose = there_and_back(samples.PoseSample(stamp_ns, parent, T))
    assert (pose.stamp_ns, pose.frame_id) == (stamp_ns, parent)
    np.testing.assert_allclose(pose.T_frame_pose, T, rtol=0, atol=1e-14)


def test_a_jpeg_image_survives_nearly():
    """Colour at full resolution: at the edge of a saturated red nothing bleeds by more than a few levels."""
    image = np.full((48, 64, 3), (60, 160, 60), np.uint8)
    image[:, 33:] = (40, 40, 220)
    sample = decoded(encode(samples.ImageSample(5, "camera", image), jpeg_quality=95))
    assert np.abs(sample.decode().astype(int) - image).max() <= 12


def test_a_recording_gives_everything_back(native, entries, profile):
    recording = open_recording(native, profile)
    observations = list(read_observations(recording))
    images = [entry.sample for entry in entries if isinstance(entry.sample, samples.ImageSample)]
    assert [o.stamp_ns for o in observations] == [image.stamp_ns for image in images]
    for frame, (observation, image) in enumerate(zip(observations, images, strict=True)):
        np.testing.assert_array_equal(observation.image_bgr, image.image_bgr)
        np.testing.assert_array_equal(observation.joints.positions, [0.5 * frame, -1.0])
    assert recording.name == "scene"
    assert recording.metadata == {"scenario": "test", "seed": "7"}
    assert recording.camera.same_optics(CAMERA)
    assert recording.joint_track().positions.shape == (20, 2)
    assert recording.distance_track().distances_m[:, 2].tolist() == [-0.001 * frame for frame in range(5)]
    assert recording.pose_track().parent == "base"
    truth = recording.transform_track("camera", "tool", ground_truth=True)
    np.testing.assert_allclose(truth.T_parent_child[:, 0, 3], 0.01 * np.arange(5), atol=1e-15)
    assert {info.topic: info.message_count for info in recording.topics()}["/PSM1/measured_js"] == 20
    assert recording.health.is_clean


@pytest.mark.parametrize("message_class", [DistanceEstimate, GroundTruthDistance])
def test_the_proto_and_its_python_agree(message_class):
    name = message_class.DESCRIPTOR.name
    text = re.sub(r"//.*", "", (SCHEMAS / f"svmdist/{name}.proto").read_text())
    declared = re.findall(r"(optional )?(\S+) (\w+) = (\d+);", text)
    file = FileDescriptorProto()
    message_class.DESCRIPTOR.file.CopyToProto(file)
    (message,) = file.message_type
    types = {1: "double", 8: "bool", 9: "string", 11: "google.protobuf.Timestamp"}
    assert file.package == "svmdist"
    assert message.name == name
    assert declared == [("optional " * f.proto3_optional, types[f.type], f.name, str(f.number)) for f in message.field]
