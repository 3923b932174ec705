"""The simulation itself: a scenario and a profile to the stream of samples that a log would hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property

from svmdist.camera import Camera, stereo_transform
from svmdist.perturbations.calibration import stated_camera, stated_right_camera, zoomed_camera
from svmdist.perturbations.perturbation import Place
from svmdist.profile import Profile
from svmdist.samples import CameraSample, Image, ImageSample, Sample, TransformSample, TransformsSample
from svmdist.simulation.arm import ArmPoses, distances
from svmdist.simulation.clearance.meters import BetweenMeter, ClearanceMeter
from svmdist.simulation.closing import Closing
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.plan import Block, Moment, Plan, between_topic, make_plan
from svmdist.simulation.pressing import Pressing
from svmdist.simulation.renderer import make_renderer
from svmdist.simulation.room.exposure import exposures, exposures_at_most, woven
from svmdist.simulation.sensor import NoiseState, Sensor
from svmdist.simulation.shutter import motion_px
from svmdist.transforms import Array

Noise = tuple[Array | None, ...]
"""The noise of one image of each camera, shape (height, width, 3) in 8-bit levels, or None where there is none."""


@dataclass(frozen=True)
class _Clearances:
    """Of each arm to the tissue, and of the first arm to each other one, shape (n,) each, over a block's moments."""

    to_tissue_m: list[Array]
    between_m: list[Array]


def simulate(
    scenario: Scenario,
    profile: Profile,
    *,
    renderer: str = "tiny",
    noise: float = 0.0,
    extras: Extras | None = None,
) -> Iterator[tuple[str, Sample]]:
    """Yield (topic, sample) in the order of time; `noise` is a standard deviation in 8-bit levels.

    Joints, poses and truth come at the profile's joint rate and at every image's stamp exactly (truth only).
    Raises SimulationError where PyBullet is missing or the profile cannot be simulated.
    """
    plan = make_plan(scenario, profile, renderer=renderer, noise=noise, extras=extras)
    with Simulator(plan) as simulator:
        for block in plan.blocks:
            yield from simulator.samples(block, simulator.draw_noise())


class Simulator(Closing):
    """Makes the samples of a plan, block by block in any order; a context manager with physics worlds of its own.

    Only the noise has an order: `draw_noise` gives that of the next image, and `noise_states` tells where the random
    streams then stand.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        cameras = range(2 if plan.extras.stereo else 1)
        self._sensors = tuple(Sensor(camera, plan.seed, plan.noise, plan.extras) for camera in cameras)
        scene, *others = (arm.scene for arm in plan.arms)
        with ExitStack() as stack:
            self._meters = [stack.enter_context(ClearanceMeter(arm.scene)) for arm in plan.arms]
            self._pressing = None
            if scene.room.dent:
                arms = [
                    (arm.scene, meter.samples) for arm, meter in zip(plan.arms, self._meters, strict=True)
                ]
                self._pressing = Pressing(arms)
            self._between = [stack.enter_context(BetweenMeter(scene, other)) for other in others]
            self._view = make_renderer(scene, plan.renderer, others, plan.seed)
            stack.enter_context(self._view)
            self._stack = stack.pop_all()

    @property
    def noise_states(self) -> tuple[NoiseState, ...]:
        """Where the random stream of each camera's noise stands."""
        return tuple(sensor.noise_state for sensor in self._sensors)

    @noise_states.setter
    def noise_states(self, states: tuple[NoiseState, ...]) -> None:
        for sensor, state in zip(self._sensors, states, strict=True):
            sensor.noise_state = state

    def draw_noise(self) -> Noise:
        """Draw the noise of the next image of each camera."""
        camera = self._plan.scene.camera
        return tuple(sensor.draw_noise(camera.width_px, camera.height_px) for sensor in self._sensors)

    def samples(self, block: Block, noise: Noise) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of a block, given the noise of its image."""
        plan, topics = self._plan, self._plan.topics
        poses = [arm.poses(block.begin, block.end) for arm in plan.arms]
        rise_m = None if plan.tissue_rise_m is None else plan.tissue_rise_m[block.begin : block.end]
        clearances = self._clearances_m([arm.q[block.begin : block.end] for arm in plan.arms], rise_m)
        for at, stamp in enumerate(plan.stamps_ns[block.begin : block.end].tolist()):
            index = block.begin + at
            if plan.with_camera_info[index]:
                yield from self._cameras(stamp)
            if plan.with_joints[index]:
                for arm, its in zip(plan.arms, poses, strict=True):
                    yield from arm.reports(stamp, its, at)
            T_camera_tissue = plan.scene.T_camera_tissue
            if rise_m is not None:
                T_camera_tissue = plan.scene.T_camera_risen_tissue(float(rise_m[at]))
            yield from self._truth(stamp, poses, T_camera_tissue, clearances, at)
            if plan.with_image[index]:
                yield topics.tf, self._nominal_transforms(stamp, poses, at)
                yield from self._images(stamp, index, block.frame, noise)

    def _cameras(self, stamp_ns: int) -> Iterator[tuple[str, Sample]]:
        left, right = self._stated_cameras
        yield self._plan.topics.camera_info, CameraSample(stamp_ns, left)
        if self._plan.extras.stereo:
            yield self._plan.topics.right_camera_info, CameraSample(stamp_ns, right)

    @cached_property
    def _stated_cameras(self) -> tuple[Camera, Camera]:
        """The left and the right camera as the log says that they are."""
        scene, perturbations = self._plan.scene, self._plan.extras.perturbations
        left, right, zoom = scene.camera, scene.right_camera, perturbations["zoom"]
        if zoom != 1.0:  # the log does not say so
            left, right = zoomed_camera(left, 1.0 / zoom), zoomed_camera(right, 1.0 / zoom)
        return stated_camera(left, perturbations), stated_right_camera(right, perturbations)

    @cached_property
    def _stated_T_camera_right(self) -> Array:
        """Where the log says that the right camera stands, shape (4, 4)."""
        if not self._plan.extras.perturbations.changes(Place.CALIBRATION):
            return self._plan.scene.T_camera_right
        stated = stereo_transform(*self._stated_cameras)
        assert stated is not None  # the baseline is not 0
        return stated

    def _clearances_m(self, q: list[Array], rise_m: Array | None) -> _Clearances:
        """Those of a block's moments, by the joints of each arm, shape (n, n_joints), and the tissue's rise, (n,)."""
        to_tissue_m = [meter.clearances_m(its, rise_m) for meter, its in zip(self._meters, q, strict=True)]
        if self._pressing is not None:
            to_tissue_m = self._pressing.clearances_m(to_tissue_m, q, rise_m)
        return _Clearances(
            to_tissue_m,
            [between.clearances_m(q[0], its) for between, its in zip(self._between, q[1:], strict=True)],
        )

    def _truth(
        self,
        stamp_ns: int,
        poses: list[ArmPoses],
        T_camera_tissue: Array,
        clearances: _Clearances,
        at: int,
    ) -> Iterator[tuple[str, Sample]]:
        """Yield where tools and tissue are, and how far from each other."""
        plan, frames, arms = self._plan, self._plan.profile.frames, self._plan.arms
        tools = [arm.true_transform(stamp_ns, its, at) for arm, its in zip(arms, poses, strict=True)]
        tissue = TransformSample(stamp_ns, frames.camera, frames.tissue, T_camera_tissue)
        yield plan.topics.ground_truth_tf, TransformsSample(stamp_ns, (tools[0], tissue, *tools[1:]))
        for arm, tool, to_tissue_m in zip(arms, tools, clearances.to_tissue_m, strict=True):
            yield arm.true_distances(tool, tissue, float(to_tissue_m[at]))
        for other, tool, between_m in zip(arms[1:], tools[1:], clearances.between_m, strict=True):
            offset_m = tools[0].T_parent_child[:3, 3] - tool.T_parent_child[:3, 3]
            topic = between_topic(plan.profile.instrument_name, other.profile.instrument_name)
            yield topic, distances(stamp_ns, offset_m, float(between_m[at]))

    def _nominal_transforms(self, stamp_ns: int, poses: list[ArmPoses], at: int) -> TransformsSample:
        """The transforms of the first arm, the right camera, and those of the other arms."""
        arms, scene = self._plan.arms, self._plan.scene
        transforms = [arm.nominal_transforms(stamp_ns, its, at) for arm, its in zip(arms, poses, strict=True)]
        right = []
        if self._plan.extras.stereo:
            camera, right_frame = scene.camera.frame_id, scene.right_camera.frame_id
            right = [TransformSample(stamp_ns, camera, right_frame, self._stated_T_camera_right)]
        return TransformsSample(
            stamp_ns, (*transforms[0], *right, *(sample for other in transforms[1:] for sample in other))
        )

    def _images(self, stamp_ns: int, index: int, frame: int, noise: Noise) -> Iterator[tuple[str, Sample]]:
        scene, topics = self._plan.scene, self._plan.topics
        parts = exposures(scene.room, scene.camera.height_px, motion_px(self._plan, index))
        first = frame * exposures_at_most(scene.room)
        drawn = [
            self._pictures(self._plan.moment(index, part.after_ns), first + number)
            for number, part in enumerate(parts)
        ]
        named = ((topics.image, scene.camera), (topics.right_image, scene.right_camera))
        for sensor, (topic, camera), its, images in zip(
            self._sensors, named[: len(self._sensors)], noise, zip(*drawn, strict=True), strict=True
        ):
            image = sensor.expose(woven(images, parts), its, frame)
            yield topic, ImageSample(stamp_ns, camera.frame_id, image)

    def _pictures(self, moment: Moment, number: int) -> list[Image]:
        """What each camera sees of a moment, which is that number `number` of the recording."""
        turn = number * len(self._sensors)
        left = self._view.frame_of(
            moment.q[0],
            moment.T_world_retractor,
            moment.q[1:],
            turn=turn,
            rise_m=moment.rise_m,
            tissue=None if self._pressing is None else self._pressing.tissue(moment),
        )
        return [left, self._view.right_frame(turn=turn + 1)] if self._plan.extras.stereo else [left]

    def close(self) -> None:
        """Leave the physics worlds; a second call does nothing."""
        self._stack.close()
