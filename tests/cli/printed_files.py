"""The files that the documentation's commands take for the user's own, made of golden logs."""

import json
from collections.abc import Callable, Iterator
from itertools import takewhile
from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from svmdist.camera import Camera
from svmdist.profile import load_profile, profile_path
from svmdist.recording.log import open_recording
from svmdist.recording.writer import EncodedSample
from svmdist.samples import Image
from tests.golden import RECORDINGS, golden_frames
from tests.synthetic import write_samples

FIRST_FRAME, FRAME_COUNT = 40, 6  # in which most of the shaft is in the picture
BASELINE_M = 0.0052
IN_ENDOSCOPE_FRAME = {"tool": "tracker", "tissue": "tissue"}


def golden_pairs() -> tuple[Camera, list[tuple[Image, Image]]]:
    """The camera, and both views of some frames from the middle of a golden log."""
    seen = golden_frames("3d/contact", range(FIRST_FRAME, FIRST_FRAME + FRAME_COUNT))
    return seen[0].camera, [(one.image_bgr, one.right.image_bgr) for one in seen]


def write_images(folder: Path, names: str, images: list[Image]) -> None:
    """Write images under numbered names, such as `{:03}_L.jpg`."""
    folder.mkdir(exist_ok=True)
    for number, image_bgr in enumerate(images):
        cv2.imwrite(str(folder / names.format(number)), image_bgr)


def write_yaml(path: Path, document: object) -> None:
    """JSON is YAML, too."""
    path.write_text(json.dumps(document), "utf-8")


def ros_camera(camera: Camera) -> dict[str, object]:
    """What ROS's `camera_calibration` writes of a camera."""
    return {
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.K.ravel().tolist()},
    }


def write_log(path: Path, source: Path, seconds: float = 60.0) -> None:
    """A robot's log: the beginning of a golden one, with a tracker in `/tf` that sees tool and tissue, and no truth."""
    messages = list(open_recording(source, load_profile()).file.source.messages())
    end_ns = messages[0].log_time_ns + round(seconds * 1e9)

    def robots() -> Iterator[tuple[str, EncodedSample]]:
        for raw in takewhile(lambda one: one.log_time_ns <= end_ns, messages):
            data, topic = raw.data, raw.topic
            if topic == "/ground_truth/tf":
                transforms = FrameTransforms.FromString(data)
                for transform in transforms.transforms:
                    transform.child_frame_id = IN_ENDOSCOPE_FRAME[transform.child_frame_id]
                data, topic = transforms.SerializeToString(), "/tf"
            if not topic.startswith("/ground_truth"):
                yield topic, EncodedSample(raw.log_time_ns, raw.schema, bytes(data))

    write_samples(path, robots())


def write_video(path: Path, pairs: list[tuple[Image, Image]]) -> None:
    """A video with both views side by side."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height = 2 * pairs[0][0].shape[1], pairs[0][0].shape[0]
        for left, right in pairs:
            frame = av.VideoFrame.from_ndarray(np.hstack([left, right]), format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def for_guide(folder: Path) -> None:
    """A folder of images with a calibration, and a robot's log with its profile."""
    camera, pairs = golden_pairs()
    write_images(folder / "frames", "{:03}.png", [left for left, _ in pairs])
    write_yaml(folder / "camera.yaml", ros_camera(camera))
    write_log(folder / "arm.mcap", RECORDINGS / "real" / "random.mcap")
    shipped = profile_path("psm13")
    (folder / "arm.toml").write_bytes(shipped.read_bytes())
    calibration = load_profile().calibration
    (folder / calibration).write_bytes((shipped.parent / calibration).read_bytes())


def for_profile(folder: Path) -> None:
    """A log of one second."""
    write_log(folder / "mine.mcap", RECORDINGS / "3d" / "contact.mcap", seconds=1.0)


def for_recording_format(folder: Path) -> None:
    """Images, videos, calibrations of ROS, OpenCV and Kalibr, and tables, in the forms that `import` reads."""
    camera, pairs = golden_pairs()
    lefts, rights = [left for left, _ in pairs], [right for _, right in pairs]
    write_images(folder / "frames", "{:03}.png", lefts)
    write_images(folder / "left", "{:03}.png", lefts)
    write_images(folder / "right", "{:03}.png", rights)
    write_images(folder / "pairs", "{:03}_L.jpg", lefts)
    write_images(folder / "pairs", "{:03}_R.jpg", rights)
    write_video(folder / "endoscope.mp4", pairs)
    for name in ("ost.yaml", "left.yaml", "right.yaml"):
        write_yaml(folder / name, ros_camera(camera))
    K, T = camera.K, np.eye(4)
    T[0, 3] = -BASELINE_M
    one = {
        "camera_model": "pinhole",
        "intrinsics": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0] * 4,
        "resolution": [camera.width_px, camera.height_px],
    }
    write_yaml(folder / "camchain.yaml", {"cam0": one, "cam1": one | {"T_cn_cnm1": T.tolist()}})
    matrices = {name: K.tolist() for name in ("M1", "M2")} | {name: [0.0] * 5 for name in ("D1", "D2")}
    t_mm = (1e3 * T[:3, 3]).tolist()
    write_yaml(folder / "stereo.yaml", {**matrices, "R": np.eye(3).tolist(), "T": t_mm})
    stamps_s = [0.04 * number for number in range(FRAME_COUNT)]
    (folder / "times.csv").write_text("".join(f"{stamp_s}\n" for stamp_s in stamps_s), "utf-8")
    (folder / "poses.csv").write_text(
        "time_s,x,y,z,qx,qy,qz,qw\n" + "".join(f"{s},0.01,0,0.1,0,0,0,1\n" for s in stamps_s), "utf-8"
    )
    (folder / "joints.csv").write_text(
        "time_s,yaw_deg,insertion_mm\n" + "".join(f"{s},5,80\n" for s in stamps_s), "utf-8"
    )


PREPARE: dict[str, Callable[[Path], None]] = {
    "docs/guide.md": for_guide,
    "docs/profile.md": for_profile,
    "docs/recording-format.md": for_recording_format,
}
"""What makes the files that a document's commands take for the user's own, by document."""
