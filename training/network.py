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
from torch import Tensor, distributed, nn, optim
from torch.nn import functional

from svmdist.profile.segmentation import INSTRUMENTS, OnnxSegmentation
from svmdist.vision.network import OnnxSegmenter
from training.instruments import DISTAL, INSTRUMENT, SHAFT, UNKNOWN
from training.pictures import Shown
from training.scene import MIDDLE

SIZE = (384, 480)  # of the input, (h, w)
STAGES = ((3, 1, 1, 16, 1), (3, 2, 6, 24, 2), (5, 2, 6, 40, 2), (3, 2, 6, 80, 3), (5, 1, 6, 112, 3), (5, 2, 6, 192, 3))
"""Kernel, stride, expansion, channels, blocks (Tan and Le 2019, where the last has one more, and a seventh follows)."""
STEM, HEADS = 32, ["scores", "keypoints"]  # channels; outputs
SKIPPED = {0: 16, 2: 24, 4: 40, 10: 112, 13: 192}  # blocks that the decoder sees, at half to a 32nd; their channels
WIDTHS = (32, 32, 48, 64, 96)  # channels of what it makes of each
FROZEN = 3  # blocks, with the stem, that stay as ImageNet made them
BATCH = 16  # pictures of a step
ENCODER_RATE, DECODER_RATE = 3e-4, 1.5e-3  # the highest, after a fiftieth of the steps; they fall as a cosine
TEACHING = 2.0  # weight of what a teacher says
ADDED = 0.002  # share of a step's weights in their running mean, which is the result
TOGETHER = 25  # steps after which the processes take the mean of their weights (Stich 2019)
SURENESS = 0.8  # of the scores: of pixels at 0.9, 85% are instrument in public images
LARGE = 4096  # weights of a layer, from which on they are kept with eight bits
OPEN = 0.02  # of a label, what may be any class: people err, and so do their outlines
KEYPOINT_WEIGHT = 12.0  # their loss is small
DOUBLED = nn.Upsample(scale_factor=2.0, mode="bilinear")
ALLOWED = torch.cat([torch.eye(4), torch.tensor([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]])]) > 0  # classes, by label


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
        return image + super().forward(image) if self.adds else super().forward(image)


class Network(nn.Module):
    """Scores (n, 4, h / 2, w / 2) and keypoints' log-odds, the same shape, of images (n, 3, h, w) in BGR, -1 to 1."""

    def __init__(self, weights: Sequence[Path]) -> None:
        """From weights of `save`, their mean where they are several (Wortsman et al. 2022), or Google's of ImageNet."""
        super().__init__()
        self.stem, self.blocks, inputs = nn.Sequential(*_convolved(3, STEM, 3, 2)), nn.ModuleList(), STEM
        for kernel, stride, expansion, outputs, count in STAGES:
            for number in range(count):
                self.blocks.append(_Block(inputs, outputs, kernel, 1 if number else stride, expansion))
                inputs = outputs
        loaded = [torch.load(path, map_location="cpu") for path in weights]
        given = {name: sum(one[name] for one in loaded) / len(loaded) for name in loaded[0]}
        if "_conv_stem.weight" in given:  # of RGB
            given["_conv_stem.weight"] = given["_conv_stem.weight"].flip(1)
            given = dict(zip(self.state_dict(), given.values(), strict=False))
        pairs = list(zip(SKIPPED.values(), (*WIDTHS[1:], WIDTHS[-1]), WIDTHS, strict=True))
        self.whole = nn.Conv2d(inputs, WIDTHS[-1], 1)
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
        nn.ModuleList([self.stem, *self.blocks[:FROZEN]]).requires_grad_(False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Both, of images."""
        found, seen = self.stem(images), list[Tensor]()
        for number, block in enumerate(self.blocks):
            found = block(found)
            if number in SKIPPED:
                seen.append(found)
        # OpenCV adds what has one pixel only after an activation
        everywhere = functional.relu(self.whole(found.mean((2, 3), keepdim=True)))
        found = self.over[-1](functional.relu(self.into[-1](found)) + everywhere)
        for number in range(len(seen) - 2, -1, -1):
            found = self.over[number](DOUBLED(found) + self.into[number](seen[number]))
        return self.scores(found), self.keypoints(found)

    def save(self, path: Path) -> None:
        """Write as ONNX, weights of large layers with eight bits, and beside it what training can go on from."""
        torch.save(self.state_dict(), path.with_suffix(".pt"))
        for weights in self.scores.parameters():
            weights.data *= SURENESS
        how = {"input_names": ["image"], "output_names": HEADS, "opset_version": 17, "dynamo": False}
        torch.onnx.export(self, (torch.zeros(1, 3, *SIZE),), str(path), **how)
        file = onnx.load(path)
        for one in list(file.graph.initializer):
            value, name = to_array(one), one.name
            if value.ndim == 4 and value.size > LARGE:  # by output channel
                scale = np.abs(value).max((1, 2, 3), keepdims=True) / np.float32(127.0) + np.float32(1e-12)
                one.CopyFrom(from_array(np.rint(value / scale).astype(np.int8), f"{name}/bits"))
                file.graph.initializer.append(from_array(scale, f"{name}/scale"))
                # Runtimes do these two once, and `DequantizeLinear` at each image
                cast = make_node("Cast", [f"{name}/bits"], [f"{name}/whole"], to=onnx.TensorProto.FLOAT)
                file.graph.node.insert(0, make_node("Mul", [f"{name}/whole", f"{name}/scale"], [name]))
                file.graph.node.insert(0, cast)
        onnx.save(file, path)


def train(rank: int, given: Namespace, shown: Shown, folder: str) -> None:
    """Train as one of several processes, which meet in a folder; the first writes the mean of the last weights."""
    torch.set_num_threads(1)
    distributed.init_process_group("gloo", f"file://{folder}/meeting", rank=rank, world_size=given.processes)
    torch.manual_seed(given.seed)  # all begin with the same decoder: only so the mean of their weights is a network
    network, rng = Network(given.start), np.random.default_rng(given.seed + 1000 * rank)
    mean = optim.swa_utils.AveragedModel(network, avg_fn=lambda old, new, n: old.lerp(new, max(ADDED, 1.0 / (n + 1))))
    rules = {**INSTRUMENTS, "method": "onnx", "model": given.teacher}
    teacher = OnnxSegmenter(OnnxSegmentation.model_validate(rules)) if given.teacher else None
    encoder, weights = ([one for one in part.parameters() if one.requires_grad] for part in (network.blocks, network))
    highest = [given.rate * ENCODER_RATE, given.rate * DECODER_RATE]
    optimiser = optim.AdamW([{"params": encoder}, {"params": weights[len(encoder) :]}], weight_decay=1e-2)
    rates = optim.lr_scheduler.OneCycleLR(optimiser, highest, max(given.steps, 1), pct_start=0.02, cycle_momentum=False)
    for step in range(1, given.steps + 1):
        made = [shown.sample(rng, SIZE) for _ in range(BATCH)]
        images, labels, maps, is_rendered = (np.stack(kind) for kind in zip(*made, strict=True))
        pixels = torch.from_numpy(images).permute(0, 3, 1, 2)  # stays channels last
        scores, odds = network((pixels.float() - MIDDLE) / MIDDLE)
        loss, near, is_real = _loss(scores, torch.from_numpy(labels)), torch.from_numpy(maps).float(), ~is_rendered
        if teacher and is_real.any():  # what it knows is kept (Li and Hoiem, "Learning without forgetting", 2016)
            answers = [teacher.outputs(image) for image in images[is_real]]
            said, keypoints = (torch.from_numpy(np.concatenate([one[name] for one in answers])) for name in HEADS)
            near[is_real] = keypoints.sigmoid()
            found, said = scores[is_real].log_softmax(1), said.log_softmax(1)
            loss = loss + TEACHING * (said.exp() * (said - found)).sum(1).mean()  # Kullback and Leibler's divergence
        keypoints = functional.binary_cross_entropy_with_logits(odds, near, reduction="none").mean((1, 2, 3))
        loss = loss + KEYPOINT_WEIGHT * (torch.from_numpy(is_rendered | bool(teacher)) * keypoints).mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(weights, 2.0)
        optimiser.step()
        rates.step()
        for value in weights if step % TOGETHER == 0 else ():
            distributed.all_reduce(value.data)
            value.data /= given.processes
        mean.update_parameters(network)
    if rank == 0:
        mean.module.save(given.model)
    distributed.destroy_process_group()


def _loss(scores: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy, and what all instruments lack in overlap (Milletari et al. 2016); a label may be open."""
    likely, known = DOUBLED(scores).log_softmax(1), labels != UNKNOWN
    allowed = likely.masked_fill(~ALLOWED[labels.long()].permute(0, 3, 1, 2), -1e4).logsumexp(1)
    entropy = -((1.0 - OPEN) * allowed + OPEN * likely.clamp_min(-12.0).mean(1)) * known
    instrument = likely.exp()[:, DISTAL:].sum(1) * known
    truth = (labels == DISTAL) | (labels == SHAFT) | (labels == INSTRUMENT)
    dice = 1.0 - (2.0 * (instrument * truth).sum((1, 2)) + 50.0) / ((instrument + truth).sum((1, 2)) + 50.0)
    return (entropy.sum((1, 2)) / (known.sum((1, 2)) + 2000.0) + 0.5 * dice).mean()
