"""The network: a small U-Net of depthwise separable convolutions, by PyTorch."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

CLASSES = 4
CHANNELS = (16, 32, 64, 112, 160)
"""Of the input's size over 2, 4, 8, 16 and 32."""


class InstrumentNet(nn.Module):
    """Scores of the four classes at half the input's size, (n, 4, h / 2, w / 2), of images (n, 3, h, w), -1 to 1."""

    def __init__(self) -> None:
        super().__init__()
        first = CHANNELS[0]
        self.stem = nn.Sequential(_convolution(3, first, 3, stride=2), _Block(first, first, expansion=2))
        self.down = nn.ModuleList(
            nn.Sequential(_Block(less, more, stride=2), _Block(more, more))
            for less, more in pairwise(CHANNELS)
        )
        last = CHANNELS[-1]
        self.context = _Context(last)
        self.up = nn.ModuleList(
            _Up(more, less) for less, more in zip(CHANNELS[-2::-1], CHANNELS[:0:-1], strict=True)
        )
        self.scores = nn.Conv2d(first, CLASSES, 1)

    def forward(self, image: Tensor) -> Tensor:
        """See the class."""
        levels = [self.stem(image)]
        for down in self.down:
            levels.append(down(levels[-1]))
        deep = self.context(levels.pop())
        for up in self.up:
            deep = up(deep, levels.pop())
        scores: Tensor = self.scores(deep)
        return scores


def _convolution(
    less: int, more: int, size: int = 1, stride: int = 1, groups: int = 1, dilation: int = 1
) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(
            less,
            more,
            size,
            stride,
            dilation * (size // 2),
            groups=groups,
            dilation=dilation,
            bias=False,
        ),
        nn.BatchNorm2d(more),
        nn.ReLU(inplace=True),
    )


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


class _Context(nn.Module):
    """What the whole picture looks like decides what is unusual in it: wide filters, and the mean of all of it."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.wide = nn.Sequential(
            _Block(channels, channels, dilation=2), _Block(channels, channels, dilation=3)
        )
        self.whole = nn.Sequential(nn.Conv2d(channels, channels, 1), nn.ReLU(inplace=True))

    def forward(self, x: Tensor) -> Tensor:
        x = self.wide(x)
        mean: Tensor = self.whole(x.mean((2, 3), keepdim=True))
        return x + mean


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
        deep = functional.interpolate(
            self.narrow(deep), scale_factor=2.0, mode="bilinear", align_corners=False
        )
        out: Tensor = self.filter(torch.cat([deep, skip], 1))
        return out
