"""The network, a small U-Net of depthwise separable convolutions, its training, and its way into an ONNX file.

Needs PyTorch, which is no dependency of svmdist.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from training.instruments import DISTAL, Array
from training.scene import HEIGHT, MIDDLE, WIDTH, augmented, halved

CLASSES = 4
CHANNELS = (16, 32, 64, 112, 160)  # of the input's size over 2, 4, 8, 16 and 32


class InstrumentNet(nn.Module):
    """Scores of the four classes at half the input's size, (n, 4, h / 2, w / 2), of images (n, 3, h, w), -1 to 1."""

    def __init__(self) -> None:
        super().__init__()
        first, last = CHANNELS[0], CHANNELS[-1]
        self.stem = nn.Sequential(_convolution(3, first, 3, stride=2), _Block(first, first, expansion=2))
        self.down = nn.ModuleList(
            nn.Sequential(_Block(less, more, stride=2), _Block(more, more))
            for less, more in pairwise(CHANNELS)
        )
        # The whole picture decides what is unusual in it: wide filters, and the mean of all of it.
        self.wide = nn.Sequential(_Block(last, last, dilation=2), _Block(last, last, dilation=3))
        self.whole = nn.Sequential(nn.Conv2d(last, last, 1), nn.ReLU(inplace=True))
        self.up = nn.ModuleList(_Up(more, less) for more, less in pairwise(CHANNELS[::-1]))
        self.scores = nn.Conv2d(first, CLASSES, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Give the scores of images."""
        levels = [self.stem(image)]
        for down in self.down:
            levels.append(down(levels[-1]))
        deep = self.wide(levels.pop())
        deep = deep + self.whole(deep.mean((2, 3), keepdim=True))
        for up in self.up:
            deep = up(deep, levels.pop())
        scores: Tensor = self.scores(deep)
        return scores


def _convolution(
    less: int, more: int, size: int = 1, stride: int = 1, groups: int = 1, dilation: int = 1
) -> nn.Module:
    padding = dilation * (size // 2)
    layer = nn.Conv2d(less, more, size, stride, padding, dilation, groups, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(more), nn.ReLU(inplace=True))


class _Block(nn.Module):
    """An inverted residual (Sandler et al. 2018, MobileNetV2): widen, filter each channel, narrow."""

    def __init__(self, less: int, more: int, stride: int = 1, expansion: int = 3, dilation: int = 1) -> None:
        super().__init__()
        wide = less * expansion
        self.adds = less == more and stride == 1
        self.body = nn.Sequential(
            _convolution(less, wide),
            _convolution(wide, wide, 3, stride, groups=wide, dilation=dilation),
            nn.Conv2d(wide, more, 1, bias=False),
            nn.BatchNorm2d(more),
        )

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.body(x)
        return x + y if self.adds else y


class _Up(nn.Module):
    """Twice the size, joined with what the encoder had of that size."""

    def __init__(self, more: int, less: int) -> None:
        super().__init__()
        self.narrow = _convolution(more, less)
        self.filter = nn.Sequential(
            _convolution(2 * less, 2 * less, 3, groups=2 * less),
            _convolution(2 * less, less),
            _Block(less, less, expansion=2),
        )

    def forward(self, deep: Tensor, skip: Tensor) -> Tensor:
        out: Tensor = self.filter(torch.cat([_doubled(self.narrow(deep)), skip], 1))
        return out


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="bilinear", align_corners=False)


@dataclass(frozen=True)
class Stage:
    """How long and how fast is trained at one size of pictures.

    The learning rate rises over the first twentieth of `horizon`, then falls as a cosine to nothing there. A step keeps
    the share `average` of the mean of weights, which is the result. Half the width and height costs a quarter.
    """

    steps: int
    batch: int
    learning_rate: float
    horizon: int
    average: float
    half_size: bool = False


STAGES = (
    Stage(steps=1000, batch=32, learning_rate=3e-3, horizon=2500, average=0.998, half_size=True),
    Stage(steps=1200, batch=16, learning_rate=2e-3, horizon=1200, average=0.995),
)


def train(pictures: Array, labels_of: Array, seed: int) -> InstrumentNet:
    """Train on one thread, so that a run can be repeated; a stage goes on from the mean of the last one's weights."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    torch.use_deterministic_algorithms(True, warn_only=True)
    mean: InstrumentNet = InstrumentNet().to(memory_format=torch.channels_last)
    for number, stage in enumerate(STAGES):
        net, mean, rng = mean, deepcopy(mean), np.random.default_rng(seed + 1000 * number)
        net.train()
        optimiser = torch.optim.AdamW(net.parameters(), stage.learning_rate, weight_decay=1e-2)
        warm = max(1, stage.horizon // 20)
        order: Array = np.empty(0, np.int64)
        losses: list[float] = []
        for step in range(stage.steps):
            while len(order) < stage.batch:
                order = np.concatenate([order, rng.permutation(len(pictures))])
            chosen, order = np.sort(order[: stage.batch]), order[stage.batch :]
            images, labels = augmented(rng, pictures[chosen], labels_of[chosen])
            if stage.half_size:
                images, labels = halved(images, labels)
            left = (step - warm) / max(1, stage.horizon - warm)
            rate = (step + 1) / warm if step < warm else 0.5 * (1.0 + float(np.cos(np.pi * left)))
            optimiser.param_groups[0]["lr"] = stage.learning_rate * rate
            loss = _loss(net(_to_input(images)), torch.from_numpy(labels.astype(np.int64)))
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 2.0)
            optimiser.step()
            keep = min(stage.average, (step + 1) / (step + 10))
            with torch.no_grad():
                for old, new in zip(mean.state_dict().values(), net.state_dict().values(), strict=True):
                    if old.dtype.is_floating_point:
                        old.mul_(keep).add_(new, alpha=1.0 - keep)
                    else:
                        old.copy_(new)
            losses.append(float(loss.detach()))
            if step % 50 == 49:
                print(f"step {step + 1}: loss {np.mean(losses[-50:]):.4f}", flush=True)
    return mean


def _to_input(images_bgr: Array) -> Tensor:
    """The network's input, (n, 3, h, w), of images (n, h, w, 3) in BGR."""
    pixels = torch.from_numpy(np.array(images_bgr)).permute(0, 3, 1, 2)  # stays channels last
    return (pixels.float() - MIDDLE) / MIDDLE


def _loss(scores: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy at full size, and what the union of instruments lacks in overlap (Milletari et al. 2016)."""
    scores = _doubled(scores)
    entropy = functional.cross_entropy(scores, labels, torch.tensor([1.0, 1.0, 1.5, 1.5]))
    likely, truth = scores.softmax(1)[:, DISTAL:].sum(1), (labels >= DISTAL).float()
    both = (likely * truth).sum((1, 2))
    dice = 1.0 - (2.0 * both + 50.0) / (likely.sum((1, 2)) + truth.sum((1, 2)) + 50.0)
    return entropy + 0.5 * dice.mean()


def scores_of(net: InstrumentNet, images_bgr: Array) -> Array:
    """The network's output, (n, 4, h / 2, w / 2), of images (n, h, w, 3)."""
    net.eval()
    with torch.no_grad():
        return np.asarray(net(_to_input(images_bgr)).numpy(), np.float32)


def predicted(net: InstrumentNet, images_bgr: Array) -> Array:
    """The class of each pixel, shape (n, h, w), of images (n, h, w, 3)."""
    scores = np.concatenate([scores_of(net, image[None]) for image in images_bgr])
    return np.asarray(_doubled(torch.from_numpy(scores)).argmax(1).numpy(), np.uint8)


def export(net: InstrumentNet, path: Path) -> None:
    """Write it as ONNX, with an input of one image of the fixed size."""
    plain = InstrumentNet()  # not in the memory format of training
    plain.load_state_dict(net.state_dict())
    names = {"input_names": ["image"], "output_names": ["scores"]}
    image = torch.zeros(1, 3, HEIGHT, WIDTH)
    torch.onnx.export(plain.eval(), (image,), str(path), **names, opset_version=17, dynamo=False)
