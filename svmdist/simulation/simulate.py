"""The simulation: a scenario and a profile to the stream of samples that a log would hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import cached_property
from itertools import chain

import cv2
import numpy as np

from svmdist.camera import Camera, stereo_transform
from svmdist.kinematics import forward_kinematics
from svmdist.perturbations import Place
from svmdist.perturbations.apply import nominal_camera, zoomed_camera
from svmdist.samples import CameraSample, DistanceSample, Image, ImageSample, Sample, TransformSample, TransformsSample
from svmdist.simulation.clearance import InstrumentClearance, TissueClearance
from svmdist.simulation.plan import Plan
from svmdist.simulation.render import Renderer
from svmdist.simulation.scene import Options
from svmdist.transforms import Array
from svmdist.vision.degradations import Degradation, degrade, image_seed, subsampled

FIELD_NS = 1e9 / 60.0  # between both fields of an interlaced frame (59.94 fields a second, ITU-R BT.601)
_NOISE_STREAMS, _DEGRADATION_STREAM = (11, 14), 15
Noise = tuple[Array | None, ...]
"""The noise of one image of each camera, shape (height, width, 3) in 8-bit levels, or None where there is none."""


class Sensors:
    """The cameras' noise, chroma and degradations by seed; `generators`: where the next image's noise begins."""

    def __init__(self, camera: Camera, seed: int, options: Options) -> None:
        self._shape, self._seed, self._options = (camera.height_px, camera.width_px, 3), seed, options
        streams = _NOISE_STREAMS if options.stereo else _NOISE_STREAMS[:1]
        self.generators = [np.random.default_rng([seed, stream]) for stream in streams]

    def draw_noise(self) -> Noise:
        """Draw the noise of the next image of each camera."""
        if not (std := self._options.noise):
            return (None,) * len(self.generators)
        return tuple(each.standard_normal(self._shape) * std for each in self.generators)

    def focus(self, camera: int, fields: Sequence[Image], frame: int) -> Image:
        """What falls on a camera's sensor at the image number `frame`: one picture, or two fields of alternate rows."""
        image, *later = [self._degraded(camera, field, frame, by_field=True) for field in fields]
        for field in later:
            image[1::2] = field[1::2]
        return image

    def expose(self, camera: int, image: Image, noise: Array | None, frame: int) -> Image:
        """What a camera reports of the image number `frame`, with the noise that was sampled for it."""
        if noise is not None:  # OpenCV rounds to the nearest level and saturates, in one pass
            image = np.asarray(cv2.add(noise, image, dtype=cv2.CV_8U), np.uint8)
        if chroma := self._options.perturbations["chroma"]:
            image = subsampled(image, chroma)
        return self._degraded(camera, image, frame, by_field=False)

    def _degraded(self, camera: int, image: Image, frame: int, *, by_field: bool) -> Image:
        is_interlaced = self._options.perturbations["interlace"] > 0.0
        for place, (name, severity) in enumerate(self._options.degradations):
            kind = Degradation(name)
            # These two blur what falls on the sensor, and so each field for itself.
            if by_field == (is_interlaced and kind in (Degradation.DEFOCUS, Degradation.MOTION_BLUR)):
                seed = image_seed(kind, camera, self._seed, _DEGRADATION_STREAM, place, frame)
                image = degrade(image, kind, severity, seed)
        return image


class Simulator(ExitStack):
    """Makes the samples of a plan, block by block in any order; a context manager with physics worlds of its own."""

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self._plan = plan
        self.sensors = Sensors(plan.scene.camera, plan.scene.seed, plan.options)
        scene, *others = scenes = [arm.scene for arm in plan.arms]
        self._tissue = TissueClearance(scenes)
        self._between = [self.enter_context(InstrumentClearance(scene, other)) for other in others]
        self._view = self.enter_context(Renderer(scenes))

    def samples(self, block: range, noise: Noise) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of a block, given the noise of its image."""
        plan = self._plan
        for index in block:
            stamp_ns = int(plan.stamps_ns[index])
            if plan.with_camera_info[index]:
                left, right = self._nominal_cameras
                yield plan.topics["camera_info"], CameraSample(stamp_ns, left)
                if plan.options.stereo:
                    yield plan.topics["right_camera_info"], CameraSample(stamp_ns, right)
            if plan.with_joints[index]:
                for arm in plan.arms:
                    yield from arm.reports(stamp_ns, index)
            if plan.with_image[index]:
                yield from self._truth(stamp_ns, index)
                yield plan.topics["tf"], self._nominal_transforms(stamp_ns, index)
                yield from self._images(stamp_ns, index, noise)

    @cached_property
    def _nominal_cameras(self) -> tuple[Camera, Camera]:
        scene, perturbations = self._plan.scene, self._plan.options.perturbations
        unzoomed = 1.0 / perturbations["zoom"]  # which the log does not report
        left, right = (zoomed_camera(each, unzoomed) for each in (scene.camera, scene.right_camera))
        return nominal_camera(left, perturbations), nominal_camera(right, perturbations, right=True)

    def _truth(self, stamp_ns: int, index: int) -> Iterator[tuple[str, Sample]]:
        """Yield the poses of tools and tissue, and their distances."""
        plan, arms, state = self._plan, self._plan.arms, self._plan.state(index)
        poses = [arm.scene.T_camera_base @ forward_kinematics(arm.scene.chain, arm.q[index]) for arm in arms]
        frames = [arm.profile.frames for arm in arms]
        tools = [TransformSample(stamp_ns, its.camera, its.tool, T) for its, T in zip(frames, poses, strict=True)]
        T_camera_tissue = plan.scene.T_camera_tissue(state.offset_m)
        tissue = TransformSample(stamp_ns, frames[0].camera, frames[0].tissue, T_camera_tissue)
        yield plan.topics["ground_truth_tf"], TransformsSample(stamp_ns, (tools[0], tissue, *tools[1:]))
        origins_m = [T[:3, 3] for T in poses]
        clearances_m = self._tissue.clearances_m(state.q, state.offset_m)
        distances = [
            (arm.topics["ground_truth_distance"], origin_m - T_camera_tissue[:3, 3], clearance_m)
            for arm, origin_m, clearance_m in zip(arms, origins_m, clearances_m, strict=True)
        ]
        for number, between in enumerate(self._between, start=1):
            topic = f"/ground_truth/{arms[0].profile.instrument_name}/{arms[number].profile.instrument_name}/distance"
            clearance_m = between.clearance_m(state.q[0], state.q[number])
            distances.append((topic, origins_m[0] - origins_m[number], clearance_m))
        for topic, between_m, clearance_m in distances:
            planar_m = float(np.linalg.norm(between_m[:2]))  # eq. (35): in the camera's xy plane
            yield topic, DistanceSample(stamp_ns, planar_m, float(np.linalg.norm(between_m)), clearance_m)

    def _nominal_transforms(self, stamp_ns: int, index: int) -> TransformsSample:
        """The transforms of the first arm, the right camera, and those of the other arms."""
        plan, scene = self._plan, self._plan.scene
        first, *others = (arm.nominal_transforms(stamp_ns, index) for arm in plan.arms)
        right = []
        if plan.options.stereo:
            is_perturbed = plan.options.perturbations.changes(Place.CALIBRATION)
            T_camera_right = stereo_transform(*self._nominal_cameras) if is_perturbed else scene.T_camera_right
            assert T_camera_right is not None  # the baseline is not 0
            right = [TransformSample(stamp_ns, scene.camera.frame_id, scene.right_camera.frame_id, T_camera_right)]
        return TransformsSample(stamp_ns, (*first, *right, *chain.from_iterable(others)))

    def _images(self, stamp_ns: int, index: int, noise: Noise) -> Iterator[tuple[str, Sample]]:
        scene, topics = self._plan.scene, self._plan.topics
        frame = int(np.count_nonzero(self._plan.with_image[:index]))  # the image's number
        interlace, count = scene.perturbations["interlace"], len(self.sensors.generators)
        delays_ns = (0.0, interlace * FIELD_NS) if interlace else (0.0,)  # even rows first, then odd ones
        fields = []
        for number, after_ns in enumerate(delays_ns, frame * len(delays_ns)):
            state = self._plan.state(index, after_ns)
            self._view.pose(state, self._tissue.indented(state.q, state.offset_m))
            fields.append([self._view.draw(camera, turn=number * count + camera) for camera in range(count)])
        cameras = ((topics["image"], scene.camera), (topics["right_image"], scene.right_camera))
        for camera, of_camera in enumerate(zip(*fields, strict=True)):
            exposed = self.sensors.expose(camera, self.sensors.focus(camera, of_camera, frame), noise[camera], frame)
            yield cameras[camera][0], ImageSample(stamp_ns, cameras[camera][1].frame_id, exposed)
