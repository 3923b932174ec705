"""The network, a small U-Net, its training, its calibration, and its way into an ONNX file. Needs PyTorch."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from time import monotonic

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from training.backgrounds import Array, Size
from training.instruments import DISTAL, INSTRUMENT, KEYPOINTS, SHAFT, UNKNOWN
from training.pictures import Outlined, near_keypoints, sample
from training.scene import MIDDLE, WIDTH, Drawn

CLASSES = 4
CHANNELS = (16, 32, 64, 112, 144)  # of the input's size over 2, 4, 8, 16 and 32
SIZE: Size = (192, 256)  # of the input, (h, w)
BATCH, HIGHEST_RATE = 16, 1.5e-3  # pictures of a step; learning rate, which falls as a cosine
AVERAGE = 0.998  # of the weights' running mean, what a step keeps; the mean is the result
TEMPERATURES = np.arange(0.5, 3.0, 0.02)
KEYPOINT_WEIGHT = 12.0  # their loss is small
# By label: which classes a pixel may have
ALLOWED = torch.cat([torch.eye(4), torch.tensor([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]])]) > 0


class InstrumentNet(nn.Module):
    """Scores of classes and log-odds of keypoints, (n, 4, h / 2, w / 2) each, of images (n, 3, h, w), -1 to 1."""

    def __init__(self) -> None:
        super().__init__()
        first, second, *_, last = CHANNELS
        self.stem = nn.Sequential(_convolution(3, first, 2), _convolution(first, first))
        down = (
            nn.Sequential(_convolution(less, more, 2), _Residual(more)) for less, more in pairwise(CHANNELS)
        )
        self.down = nn.ModuleList(down)
        self.whole = nn.Sequential(nn.Conv2d(last, last, 1), nn.ReLU())  # what is unusual in the picture
        up = list(pairwise(CHANNELS[::-1]))
        self.narrow = nn.ModuleList(nn.Conv2d(more, less, 1, bias=False) for more, less in up)
        self.filter = nn.ModuleList(_convolution(less, less) for _, less in up)
        self.skip = nn.ModuleList(nn.Conv2d(less, less, 1) for _, less in up)
        self.scores = nn.Conv2d(first, CLASSES, 1)
        self.keypoints = nn.Sequential(_convolution(second, second), nn.Conv2d(second, len(KEYPOINTS), 1))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Give the scores and the log-odds of images."""
        levels = [self.stem(image)]
        for down in self.down:
            levels.append(down(levels[-1]))
        deep = levels.pop()
        deep = deep + self.whole(deep.mean((2, 3), keepdim=True))
        for narrow, filtered, skip in zip(self.narrow, self.filter, self.skip, strict=True):
            coarser, deep = deep, filtered(functional.relu(_doubled(narrow(deep)) + skip(levels.pop())))
        return self.scores(deep), _doubled(self.keypoints(coarser))


def _convolution(less: int, more: int, stride: int = 1) -> nn.Sequential:
    layer = nn.Conv2d(less, more, 3, stride, 1, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(more), nn.ReLU(inplace=True))


class _Residual(nn.Module):
    """Two convolutions that add to what they are given (He et al. 2016)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(channels, channels), _convolution(channels, channels)[:2]

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.second(self.first(x)))


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="bilinear", align_corners=False)


def train(drawn: Drawn, real: Outlined | None, minutes: float, seed: int) -> InstrumentNet:
    """Train on one thread for some minutes; gives a network of the mean of the last weights."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rng, net = np.random.default_rng(seed), InstrumentNet()
    net.to(memory_format=torch.channels_last)
    mean = AveragedModel(net, multi_avg_fn=get_ema_multi_avg_fn(AVERAGE), use_buffers=True)
    optimiser = torch.optim.AdamW(net.train().parameters(), HIGHEST_RATE, weight_decay=1e-2)
    begun = monotonic()
    while (share := (monotonic() - begun) / (60.0 * minutes)) < 1.0:
        made = [sample(rng, drawn, real, SIZE) for _ in range(BATCH)]
        images, labels, points, known = (np.stack(kind) for kind in zip(*made, strict=True))
        near = np.stack([near_keypoints(each, SIZE) for each in points])
        rate = min(share / 0.02, 0.5 * (1.0 + float(np.cos(np.pi * share))))
        optimiser.param_groups[0]["lr"] = HIGHEST_RATE * max(rate, 1e-3)
        loss = _loss(net(_to_input(images)), *(torch.from_numpy(kind) for kind in (labels, near, known)))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimiser.step()
        mean.update_parameters(net)
    net.load_state_dict(mean.module.state_dict())
    net.eval().to(memory_format=torch.contiguous_format)
    return net


def _to_input(images_bgr: Array) -> Tensor:
    pixels = torch.from_numpy(np.array(images_bgr)).permute(0, 3, 1, 2)  # stays channels last
    return (pixels.float() - MIDDLE) / MIDDLE


def _entropy(likely: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy of each picture, shape (n,), of logarithms of probabilities; labels may leave a class open."""
    allowed = likely.masked_fill(~ALLOWED[labels.long()].permute(0, 3, 1, 2), -1e4).logsumexp(1)
    known = labels != UNKNOWN
    return -(allowed * known).sum((1, 2)) / (known.sum((1, 2)) + 2000.0)


def _loss(outputs: tuple[Tensor, Tensor], labels: Tensor, near: Tensor, known: Tensor) -> Tensor:
    """Cross-entropies, of keypoints where `known`, and what all instruments lack in overlap (Milletari et al. 2016)."""
    likely = _doubled(outputs[0]).log_softmax(1)
    instrument = likely.exp()[:, DISTAL:].sum(1) * (labels != UNKNOWN)
    truth = (labels == DISTAL) | (labels == SHAFT) | (labels == INSTRUMENT)
    both = (instrument * truth).sum((1, 2))
    dice = 1.0 - (2.0 * both + 50.0) / (instrument.sum((1, 2)) + truth.sum((1, 2)) + 50.0)
    keypoints = functional.binary_cross_entropy_with_logits(outputs[1], near.float(), reduction="none")
    masks = _entropy(likely, labels) + 0.5 * dice
    return (masks + KEYPOINT_WEIGHT * known * keypoints.mean((1, 2, 3))).mean()


def calibrate(net: InstrumentNet, drawn: Drawn, real: Outlined | None) -> None:
    """Divide outputs by the temperatures that make pictures not trained on most likely (Guo et al. 2017)."""
    for head, (images, truth) in enumerate((real or drawn[:2], drawn[::2])):
        small = (cv2.resize(one, SIZE[::-1], interpolation=cv2.INTER_AREA) for one in images)
        with torch.no_grad():
            found = torch.cat([net(_to_input(one[None]))[head] for one in small])
        if head:
            near = np.stack([near_keypoints(one * SIZE[1] / WIDTH, SIZE) for one in truth])
            loss, of = functional.binary_cross_entropy_with_logits, torch.from_numpy(near).float()
            losses = [loss(found / t, of) for t in TEMPERATURES]
        else:
            labels = torch.from_numpy(truth[:, 1::3, 1::3].copy())
            losses = [_entropy((found / t).log_softmax(1), labels).mean() for t in TEMPERATURES]
        temperature = TEMPERATURES[int(np.argmin(losses))]
        print(f"temperature {temperature:.2f}")
        for one in (net.scores, net.keypoints[1])[head].parameters():
            one.data.div_(temperature)


def export(net: InstrumentNet, path: Path) -> None:
    """Write it as ONNX, with an input of one image of the fixed size."""
    names = {"input_names": ["image"], "output_names": ["scores", "keypoints"], "opset_version": 17}
    torch.onnx.export(net, (torch.zeros(1, 3, *SIZE),), str(path), **names, dynamo=False)
