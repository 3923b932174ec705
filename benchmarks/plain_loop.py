"""The paper's steps in one loop with OpenCV and the MCAP library: what a replay's speed is compared with.

`python benchmarks/plain_loop.py FILE [decode]` runs them on every left image of a log of svmdist's own, or only reads
and decodes the images, in one thread.
"""

from __future__ import annotations

import sys
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader

SIDE_PX, PAD_PX = 96, 40
RED = (((0, 80, 60), (8, 255, 255)), ((170, 80, 60), (179, 255, 255)))
CYAN = (((80, 90, 40), (105, 255, 255)),)
GREEN = (((58, 250, 250), (62, 255, 255)),)
ORB = cv2.ORB_create(1500, edgeThreshold=8, fastThreshold=10)  # type: ignore[attr-defined]
MATCHER = cv2.BFMatcher(cv2.NORM_HAMMING)


def middle_of(hsv: Any, boxes: tuple[Any, ...], gate_px: int) -> tuple[float, float] | None:
    """The centroid of the largest region of a colour."""
    mask = np.zeros(hsv.shape[:2], np.uint8)
    for low, high in boxes:
        mask |= cv2.inRange(hsv, low, high)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    largest = max(contours, key=cv2.contourArea, default=None)
    if largest is None or cv2.contourArea(largest) < gate_px:
        return None
    moments = cv2.moments(largest)
    return moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]


def is_measured(image: Any, pattern: Any, template: Any) -> bool:
    """Segment, paste, match, fit a homography, draw the outline and find it again."""
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    tissue, tool = middle_of(hsv, RED, 50), middle_of(hsv, CYAN, 100)
    if tissue is None or tool is None:
        return False
    height, width = image.shape[:2]
    left, top = int(tool[0]) - SIDE_PX // 2, int(tool[1]) - SIDE_PX // 2
    x0, y0, x1, y1 = max(left, 0), max(top, 0), min(left + SIDE_PX, width), min(top + SIDE_PX, height)
    canvas = image.copy()
    canvas[y0:y1, x0:x1] = pattern[y0 - top : y1 - top, x0 - left : x1 - left]
    points, descriptors = ORB.detectAndCompute(canvas, None)
    pairs = [pair for pair in MATCHER.knnMatch(template[1], descriptors, k=2) if len(pair) == 2]
    good = [first for first, second in pairs if first.distance < 0.75 * second.distance]
    if len(good) < 10:
        return False
    source = np.array([template[0][match.queryIdx].pt for match in good], np.float32) - PAD_PX
    target = np.array([points[match.trainIdx].pt for match in good], np.float32)
    H, _ = cv2.findHomography(source, target, cv2.RANSAC, 3.0)
    if H is None:
        return False
    end = SIDE_PX - 1
    square = np.array([[[0, 0], [0, end], [end, end], [end, 0]]], np.float32)
    outline = cv2.perspectiveTransform(square, H).astype(np.int32)
    cv2.polylines(canvas, [outline], True, (0, 255, 0), 3, cv2.LINE_AA)
    return middle_of(cv2.cvtColor(canvas, cv2.COLOR_BGR2HSV), GREEN, 100) is not None


if __name__ == "__main__":
    cv2.setNumThreads(1)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = cv2.aruco.generateImageMarker(dictionary, 7, SIDE_PX - 16)
    rimmed = cv2.copyMakeBorder(cells, 8, 8, 8, 8, cv2.BORDER_CONSTANT, value=255)
    pattern = cv2.cvtColor(rimmed, cv2.COLOR_GRAY2BGR)
    pads = (PAD_PX, PAD_PX, PAD_PX, PAD_PX)
    padded = cv2.copyMakeBorder(pattern, *pads, cv2.BORDER_CONSTANT, value=(120, 80, 40))
    template = ORB.detectAndCompute(padded, None)
    frames = measured = 0
    with open(sys.argv[1], "rb") as stream:
        for _schema, _channel, message in make_reader(stream).iter_messages(topics=["/ECM/left/image"]):
            data = CompressedImage.FromString(message.data).data
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            frames += 1
            measured += "decode" not in sys.argv[2:] and is_measured(image, pattern, template)
    print(f"{measured} of {frames} frames measured")
