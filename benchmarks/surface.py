"""The tissue's surface by both views against known surfaces, beside fifteen lines of OpenCV on the same images.

`uv run python -m benchmarks.surface [FOLDER] [--frames N] [--thrust LOG PROFILE]` scores the golden logs with two views
(the organ is known); of FOLDER, photographs of operations that are warped into pairs (`laparoscopic-dataset/images`);
and the log of `thrust`, paper whose plane is known. It prints a table; nothing of a set is kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.generated_pages import table
from svmdist.estimation.frame import Scene
from svmdist.estimation.tissue.surface import ALL_PX
from svmdist.perturbations import Perturbations
from svmdist.profile import load_profile
from svmdist.profile.settings import StereoSettings
from svmdist.recording.log import Recording, open_recording
from svmdist.results import Failure
from svmdist.samples import Image
from svmdist.simulation.scene import Options, make_scene
from svmdist.transforms import Array, inverse, transform_points
from svmdist.vision.colour import to_grey
from svmdist.vision.disparity import disparity_map
from svmdist.vision.frame_context import make_segmenter
from svmdist.vision.instruments.evidence import picture_of
from svmdist.vision.stereo import RectifiedPair
from svmdist.workflows.check import first_of, offset_to_remove, spread_observations

GOLDEN = ("3d/contact", "3d/duo", "real/random", "real/contact")
PHOTOGRAPHS = Path("laparoscopic-dataset", "images")
WIDTH_PX, DISPARITIES_PX, ROWS_PX, NOISE, QUALITY = 640, (30.0, 70.0), 0.6, 2.0, 88
COLUMNS = ("images", "what", "unit", "of the tissue", "error, median", "p95", "within 2 deviations")


@dataclass
class Errors:
    """Errors of points, the deviations of those that have any, and the share of what is there that they cover."""

    size: Array
    std: Array | None
    share: float

    def cells(self, scale: float) -> tuple[str, ...]:
        """What a table shows of them."""
        inside = "–" if self.std is None else f"{100.0 * np.mean(self.size < 2.0 * self.std):.0f}%"
        quantiles = [f"{scale * np.percentile(self.size, p):.2f}" for p in (50.0, 95.0)]
        return (f"{100.0 * self.share:.0f}%", *quantiles, inside)


def opencv_disparity(left: Image, right: Image, low: int, high: int) -> Array:
    """Semi-global matching as OpenCV's tutorials have it: disparities, shape (h, w), NaN where there are none."""
    block = 5
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=16 * -(-(high - low) // 16),
        blockSize=block,
        P1=8 * 3 * block**2,
        P2=32 * 3 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    disparity_px = matcher.compute(left, right).astype(np.float64) / 16.0
    return np.where(disparity_px > low, disparity_px, np.nan)


def organ_errors(name: str, count: int) -> tuple[Errors, Errors]:
    """Of the surface, and of OpenCV's, against the simulated organ."""
    profile = load_profile("psm13")
    recording = open_recording(Path("recordings", f"{name}.mcap"), profile)
    made = recording.metadata
    chosen = tuple(one.partition("=")[::2] for one in made.get("perturb", "").split(",") if one)
    strengths = Perturbations(tuple((key, float(value)) for key, value in chosen))
    organ = make_scene(profile, int(made["seed"]), Options(stereo=True, perturbations=strengths)).organ
    frames = profile.frames
    track = recording.transform_track(frames.camera, frames.tissue, ground_truth=True)

    def off_m(points_m: Array, stamp_ns: int) -> Array:
        T = track.at(np.array([stamp_ns]), 10**9).values[0]
        local_m = transform_points(inverse(T), points_m)
        return np.asarray(np.abs(local_m[:, 2] - np.maximum(organ.heights_m(local_m[:, :2]), 0.0)))

    return _errors(recording, count, off_m)


def plane_errors(log: Sequence[Path], count: int, normal: Array, distance_m: float) -> tuple[Errors, Errors]:
    """The same of a log and its profile against a plane n · p = -d."""
    recording = open_recording(log[0], load_profile(str(log[1])))
    return _errors(recording, count, lambda points_m, _: np.abs(points_m @ normal + distance_m))


def _errors(recording: Recording, count: int, off_m: Callable[[Array, int], Array]) -> tuple[Errors, Errors]:
    ours, theirs = [], []
    for scene in _scenes(recording, count):
        pair, right, mask = scene.stereo_pair, scene.observation.right, scene.left.masks.tissue
        surface = scene.surface(most_px=ALL_PX)
        assert surface is not None
        assert right is not None
        assert not isinstance(pair, Failure)
        error = scene.profile.camera_error
        std_m = surface.deviations_m(scene.observation.camera, right, error)[surface.is_seen]
        ours.append(Errors(off_m(surface.points_m, scene.observation.stamp_ns), std_m, surface.share))
        points_m = _opencv_points(scene, pair, mask)
        share = len(points_m) / np.count_nonzero(mask)
        theirs.append(Errors(off_m(points_m, scene.observation.stamp_ns), None, share))
    return _joined(ours), _joined(theirs)


def _opencv_points(scene: Scene, pair: RectifiedPair, mask: Image) -> Array:
    assert scene.right is not None
    views = [scene.left.grey, scene.right.grey]
    if pair.R_rows_left is not None:
        turns = pair.homography(), pair.homography(right=True)
        views = [_turned(view, H) for view, H in zip(views, turns, strict=True)]
        mask = _turned(mask, turns[0])
    low, high = (int(pair.disparity_at(z) + pair.offset_px) for z in (0.35, 0.06))
    disparity_px = opencv_disparity(views[0], views[1], low, min(high, mask.shape[1] // 2))
    rows, columns = np.nonzero((mask > 0) & np.isfinite(disparity_px) & (disparity_px > pair.offset_px + 1.0))
    return pair.points(np.stack([columns, rows], -1), disparity_px[rows, columns] - pair.offset_px)


def _turned(image: Image, H: Array) -> Image:
    return np.asarray(cv2.warpPerspective(image, H, image.shape[::-1]), np.uint8)


def _scenes(recording: Recording, count: int) -> Iterator[Scene]:
    """Scenes of so many images, evenly over a log."""
    profile = recording.origin.profile
    segmenter = make_segmenter(profile.segmentation, profile.settings.auto)
    spread = spread_observations(recording)
    rows = offset_to_remove(first_of(spread, profile), profile)
    images = recording.encoded_observations(robot=False)
    stride = max(1, (recording.image_count() or count) // count)
    for encoded in islice(images, 0, None, stride):
        found = encoded.decode().found
        if isinstance(found, tuple):
            yield Scene(found[0], profile, segmenter, rows)


def photograph_errors(folder: Path, count: int, has_step: bool) -> tuple[Errors, Errors]:
    """Of disparities in px of photographs that are warped by known ones, with other light, highlights and rows."""
    files = sorted(folder.glob("*.jpg"))
    rng = np.random.default_rng(0)
    ours, theirs = [], []
    for at in rng.choice(len(files) // 2, count, replace=False):
        left, right, truth_px = _warped(np.asarray(cv2.imread(str(files[at])), np.uint8), rng, has_step)
        masks = picture_of(left), picture_of(right)
        truth_px = np.where(masks[0] > 0, truth_px, np.nan)
        greys = [to_grey(one) for one in (left, right)]
        found = disparity_map((greys[0], greys[1]), masks, (0.0, 1e4), StereoSettings(), ALL_PX)
        there = np.count_nonzero(np.isfinite(truth_px))
        if found is not None:
            u, v = np.meshgrid(found.columns_px.astype(np.float32), found.rows_px.astype(np.float32))
            off_px = np.abs(found.disparity_px - cv2.remap(truth_px.astype(np.float32), u, v, cv2.INTER_LINEAR))
            seen = found.is_seen & np.isfinite(off_px)
            cell_px2 = float(np.diff(found.columns_px[:2])[0]) ** 2
            share = np.count_nonzero(seen) * cell_px2 / there
            ours.append(Errors(off_px[seen], found.std_px[seen], share))
        off_px = np.abs(opencv_disparity(greys[0], greys[1], 16, 112) - truth_px)
        off_px = off_px[np.isfinite(off_px)]
        theirs.append(Errors(off_px, None, len(off_px) / there))
    return _joined(ours), _joined(theirs)


def _warped(image: Image, rng: np.random.Generator, has_step: bool) -> tuple[Image, Image, NDArray[np.float64]]:
    """A pair, and the left view's disparities: smooth waves, and a step of 12 px where wanted."""
    size = WIDTH_PX, round(image.shape[0] * WIDTH_PX / image.shape[1])
    image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    height, width = image.shape[:2]
    waves = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), width / 10)
    disparity_px = np.interp(waves, (waves.min(), waves.max()), DISPARITIES_PX)
    if has_step:
        disparity_px += 12.0 * (cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), width / 6) > 0.0)
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    right = cv2.remap(image, u + disparity_px.astype(np.float32), v - np.float32(ROWS_PX), cv2.INTER_CUBIC)
    truth_px = np.full((height, width), np.nan)
    for y in range(height):  # what is nearer hides what is behind it
        for x in np.argsort(disparity_px[y, :-1]):
            a, b = x + disparity_px[y, x], x + 1 + disparity_px[y, x + 1]
            if 0.0 < b - a < 3.0:
                at = np.arange(max(0, int(np.ceil(a))), min(width, int(np.floor(b)) + 1))
                truth_px[y, at] = np.interp(at, (a, b), disparity_px[y, x : x + 2])
    shade = 1.08 - 0.25 * ((u / width - 0.4) ** 2 + (v / height - 0.5) ** 2)
    views = []
    for view in (image.astype(np.float64), right * shade[..., None] + 4.0):
        noisy = np.clip(view + NOISE * rng.standard_normal(view.shape), 0, 255).astype(np.uint8)
        for _ in range(25):
            centre = int(rng.integers(width)), int(rng.integers(height))
            axes = int(rng.integers(2, 9)), int(rng.integers(1, 5))
            cv2.ellipse(noisy, centre, axes, float(rng.integers(180)), 0, 360, (255, 255, 255), -1, cv2.LINE_AA)
        stored = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        views.append(np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), np.uint8))
    return views[0], views[1], truth_px


def _joined(found: list[Errors]) -> Errors:
    stds = [one.std for one in found if one.std is not None]
    share = float(np.mean([one.share for one in found]))
    return Errors(np.concatenate([one.size for one in found]), np.concatenate(stds) if stds else None, share)


def main() -> None:
    """Score what is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--thrust", type=Path, nargs=2, metavar=("LOG", "PROFILE"))
    given = parser.parse_args()
    cv2.setNumThreads(1)
    scored = [(name, "mm", 1e3, organ_errors(name, given.frames)) for name in GOLDEN]
    if given.thrust is not None:
        normal = np.array([0.1389, -0.3968, -0.9073])
        scored.append(("thrust, paper", "mm", 1e3, plane_errors(given.thrust, given.frames, normal, 0.253)))
    if given.folder is not None:
        for name, has_step in (("photographs, warped", False), ("photographs with a step", True)):
            scored.append((name, "px", 1.0, photograph_errors(given.folder / PHOTOGRAPHS, given.frames, has_step)))
    rows = [
        (name, what, unit, *errors.cells(scale))
        for name, unit, scale, both in scored
        for what, errors in zip(("svmdist", "OpenCV, 15 lines"), both, strict=True)
    ]
    print(table(COLUMNS, rows))


if __name__ == "__main__":
    main()
