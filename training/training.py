"""Training on rendered pictures, and the network's way into an ONNX file that OpenCV runs. Needs PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from training.dataset import Pictures, augmented, halved
from training.instruments import DISTAL
from training.network import InstrumentNet
from training.scene import HEIGHT, MIDDLE, WIDTH


@dataclass(frozen=True)
class Stage:
    """How long and how fast is trained at one size of pictures."""

    steps: int
    batch: int
    learning_rate: float
    """At its largest: it rises over the first twentieth of `horizon`, then falls as a cosine."""
    horizon: int
    """The step at which the rate would be nothing; `steps`, or more where another stage follows."""
    average: float
    """What of the mean of weights over the steps is kept at each: that mean is a stage's result."""
    half_size: bool = False
    """At half the input's width and height, which costs a quarter: what goes with what is learnt there."""
    weight_decay: float = 1e-2


STAGES = (
    Stage(steps=1000, batch=32, learning_rate=3e-3, horizon=2500, average=0.998, half_size=True),
    Stage(steps=1200, batch=16, learning_rate=2e-3, horizon=1200, average=0.995),
)


def train(
    pictures: Pictures, stages: Sequence[Stage], seed: int, say: Callable[[int, float, InstrumentNet], None]
) -> InstrumentNet:
    """Train, on one thread, so that a run can be had again; `say` is told step, loss and mean every 50 steps."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    torch.use_deterministic_algorithms(True, warn_only=True)
    net: InstrumentNet = InstrumentNet().to(memory_format=torch.channels_last)
    for number, stage in enumerate(stages):
        net = train_stage(net, pictures, stage, np.random.default_rng(seed + 1000 * number), say)
    net.eval()
    return net


def train_stage(
    net: InstrumentNet,
    pictures: Pictures,
    stage: Stage,
    rng: np.random.Generator,
    say: Callable[[int, float, InstrumentNet], None],
) -> InstrumentNet:
    """Go on from `net`, which is changed; gives the mean of its weights."""
    mean = deepcopy(net)
    net.train()
    optimiser = torch.optim.AdamW(net.parameters(), stage.learning_rate, weight_decay=stage.weight_decay)
    warm = max(1, stage.horizon // 20)
    order: NDArray[np.int64] = np.empty(0, np.int64)
    losses: list[float] = []
    for step in range(stage.steps):
        if len(order) < stage.batch:
            order = np.concatenate([order, rng.permutation(len(pictures.images))])
        chosen, order = np.sort(order[: stage.batch]), order[stage.batch :]
        images, labels = augmented(rng, pictures.images[chosen], pictures.labels[chosen])
        if stage.half_size:
            images, labels = halved(images, labels)
        left = (step - warm) / max(1, stage.horizon - warm)
        rate = (step + 1) / warm if step < warm else 0.5 * (1.0 + float(np.cos(np.pi * left)))
        for group in optimiser.param_groups:
            group["lr"] = stage.learning_rate * rate
        loss = _loss(net(to_input(images)), torch.from_numpy(labels.astype(np.int64)))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimiser.step()
        _average(mean, net, min(stage.average, (step + 1) / (step + 10)))
        losses.append(float(loss.detach()))
        if step % 50 == 49:
            say(step + 1, float(np.mean(losses[-50:])), mean)
    return mean


def to_input(images_bgr: NDArray[np.uint8]) -> Tensor:
    """The network's input, (n, 3, h, w), of images (n, h, w, 3) in BGR."""
    pixels = torch.from_numpy(np.array(images_bgr)).permute(0, 3, 1, 2)  # stays channels last
    return (pixels.float() - MIDDLE) / MIDDLE


def _loss(scores: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy at full size, and what the union of instruments lacks in overlap (Milletari et al. 2016)."""
    scores = functional.interpolate(scores, scale_factor=2.0, mode="bilinear", align_corners=False)
    weights = torch.tensor([1.0, 1.0, 1.5, 1.5])
    entropy = functional.cross_entropy(scores, labels, weights)
    likely = scores.softmax(1)[:, DISTAL:].sum(1)
    truth = (labels >= DISTAL).float()
    both = (likely * truth).sum((1, 2))
    dice = 1.0 - (2.0 * both + 50.0) / (likely.sum((1, 2)) + truth.sum((1, 2)) + 50.0)
    return entropy + 0.5 * dice.mean()


def _average(mean: InstrumentNet, net: InstrumentNet, keep: float) -> None:
    with torch.no_grad():
        for old, new in zip(mean.state_dict().values(), net.state_dict().values(), strict=True):
            if old.dtype.is_floating_point:
                old.mul_(keep).add_(new, alpha=1.0 - keep)
            else:
                old.copy_(new)


def scores_of(net: InstrumentNet, images_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The network's output, (n, 4, h / 2, w / 2), of images (n, h, w, 3)."""
    net.eval()
    with torch.no_grad():
        return np.asarray(net(to_input(images_bgr)).numpy(), np.float32)


def predicted(net: InstrumentNet, images_bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The class of each pixel, shape (n, h, w), of images (n, h, w, 3)."""
    net.eval()
    out = []
    with torch.no_grad():
        for start in range(0, len(images_bgr), 16):
            scores = net(to_input(images_bgr[start : start + 16]))
            full = functional.interpolate(scores, scale_factor=2.0, mode="bilinear", align_corners=False)
            out.append(full.argmax(1).numpy().astype(np.uint8))
    net.train()
    return np.concatenate(out)


def export(net: InstrumentNet, path: Path) -> None:
    """Write it as ONNX, with an input of one image of the fixed size."""
    plain = InstrumentNet()
    plain.load_state_dict(net.state_dict())
    torch.onnx.export(
        plain.eval(),
        (torch.zeros(1, 3, HEIGHT, WIDTH),),
        str(path),
        input_names=["image"],
        output_names=["scores"],
        opset_version=17,
        dynamo=False,
    )
