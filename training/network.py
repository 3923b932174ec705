"""The network in its ONNX file: PyTorch runs it, goes on training it, and writes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import onnx
import torch
from onnx.numpy_helper import from_array, to_array
from torch import Tensor, nn
from torch.nn import functional

from training.backgrounds import Array, Size
from training.instruments import DISTAL, INSTRUMENT, SHAFT, UNKNOWN
from training.pictures import Shown, near_keypoints
from training.scene import MIDDLE

SIZE: Size = (192, 256)  # of the input, (h, w)
BATCH, HIGHEST_RATE = 16, 4e-4  # pictures of a step; learning rate, which falls as a cosine
REHEARSED, TEACHING = (
    5,
    2.0,
)  # pictures of a step that are drawn as earlier; weight of what an earlier net says of them
AVERAGE = 0.998  # of the weights' running mean, what a step keeps; the mean is the result
OPEN = 0.02  # of a label, what may be any class: people err, and so do their outlines
Attributes = Mapping[str, Any]
KEYPOINT_WEIGHT = 12.0  # their loss is small
# By label: which classes a pixel may have
ALLOWED = torch.cat([torch.eye(4), torch.tensor([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]])]) > 0


class Network(nn.Module):
    """A net of an ONNX file as PyTorch runs it: what it gives, by name, of images (n, 3, h, w) from -1 to 1.

    The file that ships holds two, whose log-probabilities it averages: `old`, of drawings alone, and `new`, with
    `keypoints`, which training goes on with.
    """

    def __init__(self, path: Path, outputs: Sequence[str] = ("new", "keypoints")) -> None:
        super().__init__()
        self.file, needed = onnx.load(path), set(outputs)
        self.nodes: list[Any] = []
        for node in reversed(self.file.graph.node):
            if needed & set(node.output):
                self.nodes.insert(0, node)
                needed |= set(node.input)
        self.trained = dict[str, nn.Parameter]()
        for one in self.file.graph.initializer:
            if one.name in needed:
                value = torch.from_numpy(to_array(one).astype(np.float32))
                layout = torch.channels_last if value.ndim == 4 else torch.contiguous_format
                self.trained[one.name] = nn.Parameter(value.contiguous(memory_format=layout))

    def forward(self, images: Tensor) -> dict[str, Tensor]:
        """Give what was asked for, and what leads there."""
        found = {"image": images, **self.trained}
        for node in self.nodes:
            of = {one.name: onnx.helper.get_attribute_value(one) for one in node.attribute}
            found[node.output[0]] = OPERATORS[node.op_type](of, *(found.get(name) for name in node.input))
        return found

    def save(self, path: Path) -> None:
        """Write the file with the trained weights, in the precision that they had."""
        for one in self.file.graph.initializer:
            if one.name in self.trained:
                value = self.trained[one.name].detach().contiguous().numpy().astype(to_array(one).dtype)
                one.CopyFrom(from_array(value, one.name))
        onnx.save(self.file, path)


def _convolved(of: Attributes, image: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    return functional.conv2d(image, weight, bias, of["strides"], of["pads"][:2], of["dilations"], of["group"])


def _resized(_: Attributes, image: Tensor, __: Tensor | None, scales: Tensor) -> Tensor:
    factors = tuple(scales.tolist()[2:])
    return functional.interpolate(image, scale_factor=factors, mode="bilinear", align_corners=False)


OPERATORS: dict[str, Callable[..., Tensor]] = {
    "Add": lambda _, a, b: a + b,
    "Cast": lambda _, a: a,
    "Concat": lambda of, *all_: torch.cat(all_, of["axis"]),
    "Constant": lambda of: torch.from_numpy(to_array(of["value"]).copy()),
    "Conv": _convolved,
    "Mul": lambda _, a, b: a * b,
    "ReduceMean": lambda of, a: a.mean(tuple(of["axes"]), keepdim=True),
    "Relu": lambda _, a: functional.relu(a),
    "Resize": _resized,
}


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="bilinear", align_corners=False)


def train(network: Network, shown: Shown, minutes: float, seed: int, teacher: Network | None = None) -> None:
    """Go on with a network on one thread for some minutes; its weights are then the mean of the last ones.

    Of what is drawn as earlier it also learns what its teacher says: what that knows of rooms is kept (Li and Hoiem,
    "Learning without forgetting", 2016).
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rng, weights = np.random.default_rng(seed), network.trained
    mean = {name: value.detach().clone() for name, value in weights.items()}
    optimiser = torch.optim.AdamW(weights.values(), HIGHEST_RATE, weight_decay=1e-3)
    rehearsed = REHEARSED if teacher else 0
    begun = monotonic()
    while (share := (monotonic() - begun) / (60.0 * minutes)) < 1.0:
        made = [shown.rehearsed(rng) if n < rehearsed else shown.sample(rng, SIZE) for n in range(BATCH)]
        images, labels, points, known = (np.stack(kind) for kind in zip(*made, strict=True))
        near = np.stack([near_keypoints(each, SIZE) for each in points])
        rate = min(share / 0.03, 0.5 * (1.0 + float(np.cos(np.pi * share))))
        optimiser.param_groups[0]["lr"] = HIGHEST_RATE * max(rate, 1e-3)
        shown_to = _to_input(images)
        found = network(shown_to)
        truth = (torch.from_numpy(kind) for kind in (labels, near, known))
        loss = _loss(found["new"], found["keypoints"], *truth)
        if teacher:
            loss = loss + TEACHING * _divergence(found["new"][:rehearsed], teacher, shown_to[:rehearsed])
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(list(weights.values()), 2.0)
        optimiser.step()
        for name, value in weights.items():
            mean[name].lerp_(value.detach(), 1.0 - AVERAGE)
    for name, value in weights.items():
        value.data = mean[name]


def _divergence(scores: Tensor, teacher: Network, images: Tensor) -> Tensor:
    """Kullback and Leibler's, of scores (n, 4, h, w) from what the teacher gives of the same images."""
    with torch.no_grad():
        said = teacher(images)["old"].log_softmax(1)
    return (said.exp() * (said - scores.log_softmax(1))).sum(1).mean()


def _to_input(images_bgr: Array) -> Tensor:
    pixels = torch.from_numpy(np.array(images_bgr)).permute(0, 3, 1, 2)  # stays channels last
    return (pixels.float() - MIDDLE) / MIDDLE


def _entropy(likely: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy of each picture, shape (n,), of logarithms of probabilities; labels may leave a class open."""
    allowed = likely.masked_fill(~ALLOWED[labels.long()].permute(0, 3, 1, 2), -1e4).logsumexp(1)
    likely = (1.0 - OPEN) * allowed + OPEN * likely.clamp_min(-12.0).mean(1)
    known = labels != UNKNOWN
    return -(likely * known).sum((1, 2)) / (known.sum((1, 2)) + 2000.0)


def _loss(scores: Tensor, near_odds: Tensor, labels: Tensor, near: Tensor, known: Tensor) -> Tensor:
    """Cross-entropies, of keypoints where `known`, and what all instruments lack in overlap (Milletari et al. 2016)."""
    likely = _doubled(scores).log_softmax(1)
    instrument = likely.exp()[:, DISTAL:].sum(1) * (labels != UNKNOWN)
    truth = (labels == DISTAL) | (labels == SHAFT) | (labels == INSTRUMENT)
    both = (instrument * truth).sum((1, 2))
    dice = 1.0 - (2.0 * both + 50.0) / (instrument.sum((1, 2)) + truth.sum((1, 2)) + 50.0)
    keypoints = functional.binary_cross_entropy_with_logits(near_odds, near.float(), reduction="none")
    masks = _entropy(likely, labels) + 0.5 * dice
    return (masks + KEYPOINT_WEIGHT * known * keypoints.mean((1, 2, 3))).mean()
