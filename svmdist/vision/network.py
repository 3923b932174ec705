"""Segmentation by a network in an ONNX file, run by onnxruntime where it is installed, else by OpenCV."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.errors import ProfileError, did_you_mean
from svmdist.files import open_regular, why
from svmdist.profile.segmentation import ClassRegion, OnnxSegmentation
from svmdist.samples import Image
from svmdist.vision.colour import Masks, field_of_view

MARGIN = 0.02  # from the border, over the image's width, where a part may end: networks are coarse
VIEW_PX = 480  # longer side of the image, about, in which the view is looked for
LEAST_AREA = 0.003  # an instrument's least part of the picture, as of `auto`
BLACK_LEVEL = 24  # of 255, in every channel: video codes black as 16, and noise of a few levels lies on it
# OpenCV's convolutions give the largest float in place of infinity and of what is no number
FINITE = float(np.finfo(np.float32).max)
MAX_FILE_BYTES = 2 << 30  # protobuf, which ONNX is written in, ends at 2 GiB

Labels = NDArray[np.int32]
Tensor = NDArray[np.generic]
Runtime = Callable[[NDArray[np.float32]], dict[str, Tensor]]
"""Runs a network: of its input, (1, 3, h, w), all outputs by name."""


class OnnxSegmenter:
    """`method = "onnx"`: the class of every pixel by a network; ProfileError at once where it cannot run."""

    def __init__(self, rules: OnnxSegmentation) -> None:
        self._rules = rules
        net, blank = _read(rules.model), np.zeros((rules.height_px, rules.width_px, 3), np.uint8)
        self._output, self._runtime = _output_name(net, rules), _by_opencv(net)
        tried = self._run(blank)
        self._runtime = _by_onnxruntime(rules.model, network_input(blank, rules)) or self._runtime
        count = tried.shape[1] if _has_scores(tried) else np.inf
        for name, region in rules.parts.items():
            if beyond := [number for number in region.class_ids if number >= count]:
                asked = f"segmentation.{name}.class_ids asks for class {beyond[0]}"
                raise ProfileError(f"{rules.model}: {asked}, and the network has {count} classes, 0 to {count - 1}")

    def masks(self, bgr: Image) -> Masks:
        """The masks of an image, shape (h, w, 3) in BGR as recorded."""
        left, top, width, height = self.view(bgr) if self._rules.crop_to_view else (0, 0, *bgr.shape[1::-1])
        in_view = np.s_[top : top + height, left : left + width]
        output = self._run(np.ascontiguousarray(bgr[in_view]))
        labels = np.full(bgr.shape[:2], -1, np.int32)  # outside of the view: no class
        if _has_scores(output):
            labels[in_view] = _best_class(np.asarray(output[0], np.float32), (width, height))
        else:
            small = output.reshape(output.shape[-2:]).astype(np.int32)
            labels[in_view] = cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
        rules, black = self._rules, _black(bgr)
        instrument, shaft = _of(labels, rules.instrument), _of(labels, rules.shaft)
        if rules.from_border:
            kept = _from_border(instrument | shaft, field_of_view(black))
            instrument, shaft = instrument & kept, shaft & kept
        return Masks(_of(labels, rules.tissue), instrument, None if rules.shaft is None else shaft, black)

    @staticmethod
    def view(bgr: Image) -> tuple[int, int, int, int]:
        """Left, top, width and height in px of the box around what the endoscope shows; all of a dark image."""
        height, width = bgr.shape[:2]
        step = max(1, max(height, width) // VIEW_PX)
        left, top, wide, high = cv2.boundingRect(field_of_view(_black(np.ascontiguousarray(bgr[::step, ::step]))))
        if not wide:
            return 0, 0, width, height
        left, top, right, bottom = (step * side for side in (left, top, left + wide, top + high))
        return left, top, min(right, width) - left, min(bottom, height) - top

    def scores(self, image_bgr: Image) -> NDArray[np.float32]:
        """The classes' scores, (C, h', w'), of a BGR image, by a network that gives scores."""
        return np.asarray(self._run(image_bgr)[0], np.float32)

    def outputs(self, image_bgr: Image) -> dict[str, Tensor]:
        """What the network gives of a BGR image, by name and unchecked; give it what `view` leaves of the image.

        The network that ships gives `scores`, logarithms of the classes' probabilities up to a constant of each pixel,
        and `keypoints`, log-odds that a pixel is within 1/64 of the image's width of where a shaft enters the view,
        where one ends, a hinge of jaws, a tip: shape (1, 4, h', w') each.
        """
        return self._runtime(network_input(image_bgr, self._rules))

    def _run(self, image_bgr: Image) -> Tensor:
        """The network's output, checked: (1, C, h', w') scores, or (1, 1, h', w') or (1, h', w') labels."""
        rules, where = self._rules, f"{self._rules.model}: output {self._output}"
        try:
            output = self.outputs(image_bgr)[self._output]
        except (cv2.error, MemoryError) as problem:
            size, channels = f"{rules.width_px}x{rules.height_px}", rules.channels.upper()
            why_not = f"the network does not run on one {channels} image of {size}: {_first_words(problem)}"
            no_memory = isinstance(problem, MemoryError) or getattr(problem, "code", 0) == cv2.Error.StsNoMem
            if no_memory or "bad_alloc" in str(problem):
                why_not = f"not enough memory to run the network on {size}"
            raise ProfileError(f"{rules.model}: {why_not}") from None
        if output.ndim not in (3, 4) or output.shape[0] != 1 or 0 in output.shape:
            expected = "class scores (1, C, h, w), or labels (1, 1, h, w) or (1, h, w)"
            raise ProfileError(f"{where} has shape {output.shape}; expected {expected}")
        if not (np.abs(output) < FINITE).all():
            raise ProfileError(f"{where} is not finite: are mean and scale right?")
        if not _has_scores(output) and not np.array_equal(output, np.round(output)):
            why_not = "has one channel, so that it should hold whole class numbers, and holds fractions"
            raise ProfileError(f"{where} of shape {output.shape} {why_not}; class scores need two channels or more")
        return output


def _by_opencv(net: cv2.dnn.Net) -> Runtime:
    lock, names = Lock(), net.getUnconnectedOutLayersNames()  # OpenCV 5 gives all outputs or one

    def run(blob: NDArray[np.float32]) -> dict[str, Tensor]:
        with lock, _quiet():  # a network holds its input and output while it runs
            net.setInput(blob)
            return dict(zip(names, map(np.asarray, net.forward(names)), strict=True))

    return run


def _by_onnxruntime(path: Path, blob: NDArray[np.float32]) -> Runtime | None:
    """The same in 0.6 of the time, where onnxruntime is installed and runs the network, too."""
    try:
        import onnxruntime
    except ImportError:
        return None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # frames are worked on in parallel
    options.log_severity_level = 4  # what it cannot run, OpenCV does
    try:
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        names, given = [one.name for one in session.get_outputs()], session.get_inputs()[0].name
        session.run(names, {given: blob})
    except Exception:  # its errors have no class in common
        return None
    return lambda blob: dict(zip(names, session.run(names, {given: blob}), strict=True))


def _of(labels: Labels, region: ClassRegion | None) -> Image:
    """Pixels of a region's classes; none without a region."""
    mask = np.zeros(labels.shape, np.uint8)
    for class_id in region.class_ids if region else ():
        mask[labels == class_id] = 255
    return mask


def _from_border(union: Image, picture: Image) -> Image:
    """Connected parts of the instrument that reach the border of the picture; the image's own edge is border, too."""
    reach = max(2, round(MARGIN * union.shape[1]))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    inner = cv2.erode(picture, kernel, borderValue=0)
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(union & picture)
    kept = np.zeros(count, np.uint8)
    kept[np.unique(parts[inner == 0])] = 255
    kept[statistics[:, cv2.CC_STAT_AREA] < LEAST_AREA * cv2.countNonZero(picture)] = 0
    kept[0] = 0
    return np.asarray(kept[parts], np.uint8)


def _black(bgr: Image) -> Image:
    """Pixels as black as the border around an endoscope's view, which no class represents."""
    return np.asarray(cv2.inRange(bgr, np.full(3, 0), np.full(3, BLACK_LEVEL)), np.uint8)


def _has_scores(output: Tensor) -> bool:
    return output.ndim == 4 and output.shape[1] > 1


def network_input(image_bgr: Image, rules: OnnxSegmentation) -> NDArray[np.float32]:
    """The network's input, shape (1, 3, h, w): the image stretched to its size, (pixel - mean) * scale."""
    size = (rules.width_px, rules.height_px)
    # Averaging over a pixel's area keeps what is thinner than a pixel from flickering.
    shrinks = image_bgr.shape[1] >= size[0] and image_bgr.shape[0] >= size[1]
    resized = cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    channels = cv2.split(resized)[:: -1 if rules.channels == "rgb" else 1]
    mean, scale = np.array(rules.mean, np.float32), np.array(rules.scale, np.float32)
    levels = (np.arange(256, dtype=np.float32)[:, None] - mean) * scale
    scaled = [cv2.LUT(channel, of_it) for channel, of_it in zip(channels, levels.T, strict=True)]
    return np.asarray(scaled, np.float32)[None]


def _best_class(scores: NDArray[np.float32], size: tuple[int, int]) -> Labels:
    """The class of the highest score, (h, w), of scores (C, h', w'), at `size` = (w, h); the first one of a tie.

    Interpolated scores put the border between classes where they are equal, not at steps of the network's pixels.
    One class is enlarged at a time: twenty at once would be 160 MB of an HD image.
    """
    best = np.asarray(cv2.resize(scores[0], size), np.float32)
    labels = np.zeros(best.shape, np.int32)
    for number in range(1, len(scores)):
        score = cv2.resize(scores[number], size)
        labels[score > best] = number
        np.maximum(best, score, out=best)
    return labels


def _read(path: Path) -> cv2.dnn.Net:
    try:
        with open_regular(path) as file:
            size = file.seek(0, 2)
    except OSError as problem:
        raise ProfileError(f"{path}: cannot read the network: {why(problem)}") from None
    if size > MAX_FILE_BYTES:
        raise ProfileError(f"{path}: cannot read the network: {size >> 20} MiB; an ONNX file holds at most 2 GiB")
    try:
        with _quiet():
            net = cv2.dnn.readNetFromONNX(str(path))
    except MemoryError:
        raise ProfileError(f"{path}: not enough memory to load the network") from None
    except cv2.error as problem:
        why_not = f"not an ONNX model that OpenCV {cv2.__version__} can read"
        if "create layer" in str(problem) or "handleNode" in str(problem):
            why_not = f"OpenCV {cv2.__version__} cannot run this network: {_first_words(problem)}"
        raise ProfileError(f"{path}: {why_not}") from None
    if net.empty():
        raise ProfileError(f"{path}: an ONNX model without a network in it")
    return net


def _output_name(net: cv2.dnn.Net, rules: OnnxSegmentation) -> str:
    names = [str(name) for name in net.getUnconnectedOutLayersNames()]
    if rules.output in names:
        return rules.output
    if rules.output is not None:
        raise ProfileError(f"{rules.model}: no output {rules.output}: {did_you_mean(rules.output, names)}")
    if len(names) != 1:
        found = f"the network has {len(names)} outputs"
        raise ProfileError(f"{rules.model}: {found}; name one in segmentation.output: {', '.join(names)}")
    return names[0]


def _first_words(problem: Exception) -> str:
    text = " ".join(str(getattr(problem, "err", "") or problem).replace(">", " ").split())
    return text if len(text) <= 160 else f"{text[:157]}..."


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV's own log lines off stderr: the error says what is wrong, once."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)
