"""Replay: the one loop over a recording's observations, which every workflow takes its results from.

    reading thread:  encoded images, joints, transforms
    worker threads:  decode, degrade, detect                        (nothing depends on the frame before)
    this thread:     associate instruments, estimate, clearance between instruments     (in order)

Each image is decoded once and looked at once, however many methods measure it. The results are the same for any
number of workers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import RecordingError
from svmdist.estimation.alarms import AlarmRules, AlarmWatch
from svmdist.estimation.association import Association
from svmdist.estimation.comparison import Checks
from svmdist.estimation.distances import with_clearance_between
from svmdist.estimation.frame import Arm, Frame, Needs, Scene, prefetch
from svmdist.estimation.methods import make_estimator
from svmdist.profile.robot import Tissue
from svmdist.recording.log import Recording
from svmdist.recording.observations import ALL_IMAGES, Decoded, EncodedObservation
from svmdist.recording.source import LossKind
from svmdist.recording.topics import Role
from svmdist.results import FrameResult, as_pixel
from svmdist.samples import Image, Observation, Rejection, Status
from svmdist.vision.frame_context import seen_through
from svmdist.vision.stereo import LEVEL
from svmdist.workflows import check
from svmdist.workflows.parallel import in_order, one_opencv_thread, usable_cores
from svmdist.workflows.request import CLEAN, Condition, OwnEstimator, Setup


@dataclass(frozen=True)
class Replayed:
    """What one method gave for one image under one condition: a result and its cost for each wanted instrument."""

    results: tuple[FrameResult, ...]
    seconds: tuple[float, ...]
    frames: tuple[Frame, ...] = ()  # what it was given; empty for an image that could not be read
    image_bgr: Image | None = None  # as it was recorded, with its fields and its lens; None where it could not be read


def replay(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    jobs: int | None = None,
    rest: bool = True,
    alarms: AlarmRules | None = None,
) -> Iterator[tuple[Replayed, ...]]:
    """Yield for each image what every setup gave under every condition, conditions first, in order.

    The setups share a profile. Every setup and condition has estimators of its own, so that what one remembers never
    reaches another. `jobs` threads work ahead, by default one for each core. Without `rest`, what no method uses is not
    read. Raises RecordingError at once for a wanted instrument that the recording has no topics of, and at the end
    where there was no image, and CalibrationError for another camera. Where the lag of a recording is known, methods
    take the offset of its joints for as well known.
    """
    return _Replay(recording, setups, conditions).run(usable_cores() if jobs is None else jobs, rest, alarms)


class MultiInstrumentEstimator:
    """One method on every wanted instrument of a recording, each with an estimator of its own.

    No row is `ok` of a method that relies on what `checks` contradict, by instrument; nor one of another camera than
    `camera`, the log's first, where a calibration is of that. With `left_alone` it sees no right view.
    """

    def __init__(
        self, setup: Setup, arms: Sequence[Arm], checks: Mapping[str, Checks], camera: Camera, *, left_alone: bool
    ) -> None:
        self._setup, self._arms, self._camera, self._left_alone = setup, arms, camera, left_alone
        own, mapping = setup.own, setup.mapping
        self._estimators = [OwnEstimator(own) if own else make_estimator(setup.method, arm, mapping) for arm in arms]
        self.looks_for_tool = not setup.is_given and setup.method != "kinematic"
        known = {} if own else checks
        self._contradictions = {name: one.contradiction(setup.method) for name, one in known.items()}
        needs: Needs = self._estimators[0].needs
        self.needs = needs.left_alone() if left_alone else needs
        self.keeps_state: bool = self._estimators[0].keeps_state

    def estimate(self, frames: Sequence[Frame], spent_s: Mapping[str, float]) -> Replayed:
        """Measure one image: a frame for each instrument; `spent_s`: what detections computed ahead took."""
        setup = self._setup
        shared_s = sum(spent_s.get(name, 0.0) for name in self.needs.scene + self.needs.frame) / len(frames)
        if self._left_alone:
            frames = [frame.left_alone() for frame in frames]
        results, seconds = [], []
        for estimator, arm, frame in zip(self._estimators, self._arms, frames, strict=True):
            start_s = time.thread_time()
            result = estimator.estimate(frame)
            seconds.append(shared_s + time.thread_time() - start_s)
            lens, places = frame.scene.lens, (("tool_px", result.image.tool_px), ("tissue_px", result.image.tissue_px))
            in_image = {key: as_pixel(seen_through(lens, np.array([px]))[0]) for key, px in places if px is not None}
            result = replace(result.with_image(**in_image), instrument=arm.profile.instrument_name)
            said = self._contradictions.get(result.instrument, "")
            if setup.calibration and not self._camera.same_optics(lens):
                said = "the calibration is for the camera as it was first"
            if result.measured and said:
                result = result.rejected(Status.INCONSISTENT, said)
            is_named_by_tag = result.measured and setup.method == "fiducial"
            results.append(result.doubted(frame.ambiguity) if frame.ambiguity and not is_named_by_tag else result)
        if len(results) > 1 and not setup.is_given:
            results = with_clearance_between(results, [arm.body for arm in self._arms])
        return Replayed(tuple(results), tuple(seconds), tuple(frames))


def _shows_instrument(scene: Scene) -> bool:
    """Whether either view shows any part of one: a simulated one may be hidden, and move while nothing else does."""
    views = [view for view in (scene.left, scene.right) if view is not None]
    parts = [part for view in views for part in (view.masks.instrument, view.masks.shaft) if part is not None]
    return any(part.any() for part in parts) or any(view.tags for view in views)


def image_stamps_ns(recording: Recording) -> list[int]:
    """The stamp of every image of a log, in file order; raises RecordingError for a log without one."""
    stamps = [one.stamp_ns for one in recording.encoded_observations(robot=False, right=False)]
    if not stamps:
        unread = f"{recording.path.name}: no image on {recording.topic_of(Role.IMAGE)} can be read"
        raise RecordingError("; ".join([unread, *recording.health.describe()]))
    return stamps


Unfinished = Callable[[], list[Replayed]]
"""What is left to do of an image under a condition, in the order of the log, for a result of each method."""


class _Replay:
    """One pass over a recording."""

    def __init__(self, recording: Recording, setups: Sequence[Setup], conditions: Sequence[Condition]) -> None:
        self._recording = recording
        setups = [setup.for_log(recording).knowing(recording.lag) for setup in setups]
        self._setup = setups[0]
        for setup in setups:
            setup.require_camera(recording)
        self._places = [recording.instruments.index(name) for name in recording.measured]
        self._arms = [Arm(self._setup.profile.for_instrument(name)) for name in recording.instruments]
        self._stereo_arms = self._arms
        self._conditions = tuple(conditions)
        self._segmenter = self._setup.segmenter  # one network, whatever becomes of the setup
        self._rows = LEVEL
        self._looked: list[dict[int, list[Frame]]] = [{} for _ in conditions]
        self._checks: list[dict[str, Checks]] = [{} for _ in conditions]
        if not all(setup.is_planar or setup.is_given for setup in setups):
            self._compare(any(setup.needs_right_view for setup in setups))
        several = check.needs_association(self._arms) and not all(setup.is_given for setup in setups)
        self._associations = [Association(self._arms) if several else None for _ in conditions]
        self._estimators = [[self._estimator(setup, known) for setup in setups] for known in self._checks]
        self._needs = reduce(Needs.__or__, (one.needs for one in self._estimators[0]))

    def _compare(self, needs_rows: bool) -> None:
        """Look at some images of all of the log: find plates and the offset of rows, compare what must agree."""
        profile, health = self._setup.profile, self._recording.health
        spread = check.spread_observations(self._recording)
        self._arms = self._stereo_arms = check.arms_of(self._recording, profile, spread)
        if needs_rows:
            self._rows = check.offset_to_remove(check.first_of(spread, profile), profile)
        if profile.tissue is None:
            return
        self._check(spread, int(needs_rows))
        first = self._checks[0]
        if self._conditions[0] == CLEAN and (said := check.warning(first)):
            health.lose(LossKind.CONTRADICTION, said)
        if needs_rows and any(one.bends_rows for one in first.values()):
            views = check.compare_views(check.first_of(spread, profile), profile)
            if views.rows is not None and not views.refusal:
                # What bends the rows, a lens or a turn, moves columns as much, over the view.
                self._rows, camera = views.rows, self._recording.camera
                std_rad = 0.5 * camera.width_px / camera.K[0, 0] * float(np.hypot(*views.rows.slope))
                self._setup = self._setup.with_stds("camera_error", right_rotation_std_rad=std_rad)
                self._arms = self._stereo_arms = self._arms_with(self._setup)
                self._check(spread, int(needs_rows))
        self._inflate_tissue(profile.tissue, list(self._checks[0].values()))

    def _check(self, spread: Sequence[EncodedObservation], pairs: int) -> None:
        self._looked.clear()  # so that no image is held twice
        how = self._recording, spread, self._arms, self._segmenter, self._rows
        found = [check.checked(*how, condition, pairs=pairs) for condition in self._conditions]
        self._checks, self._looked = map(list, zip(*found, strict=True))

    def _inflate_tissue(self, tissue: Tissue, found: Sequence[Checks]) -> None:
        """Let the tissue be as uncertain as it is seen elsewhere, or as a guess where no second view shows it."""
        off_m = next((one.tissue_off_m for one in found if one.tissue_off_m is not None), None)
        shape_m = max(one.tissue_shape_off_m for one in found)
        std_m = tissue.unverified_std_m if off_m is None else off_m
        if self._rows.bends:
            std_m = max(std_m, tissue.unverified_std_m)
        if tissue.mesh is not None:
            shape_m = max(shape_m, off_m or 0.0)
        if std_m <= tissue.plane_distance_std_m and shape_m == 0.0:
            return
        shaped = self._setup.with_stds("tissue", surface_std_m=shape_m)
        self._setup = shaped.with_stds("tissue", plane_distance_std_m=std_m)
        self._arms = self._arms_with(self._setup)
        # A method that measures its height and surface itself is only affected where its shape is another one.
        self._stereo_arms = self._arms if off_m is None else self._arms_with(shaped)
        self._looked = [{} for _ in self._conditions]

    def _arms_with(self, setup: Setup) -> list[Arm]:
        return [Arm(setup.profile.for_instrument(arm.profile.instrument_name), arm.has_plate) for arm in self._arms]

    def _estimator(self, setup: Setup, known: Mapping[str, Checks]) -> MultiInstrumentEstimator:
        """A method on the wanted instruments; one that measures the tissue itself takes the profile as it is."""
        # Of what bends aligned rows, one that keeps a state would learn in one part of the view for all of it.
        left_alone = self._rows.bends and setup.method == "fused"
        arms = self._stereo_arms if setup.needs_right_view and not left_alone else self._arms
        chosen, camera = [arms[place] for place in self._places], self._recording.camera
        return MultiInstrumentEstimator(setup, chosen, known, camera, left_alone=left_alone)

    def run(self, jobs: int, rest: bool, alarms: AlarmRules | None) -> Iterator[tuple[Replayed, ...]]:
        robot = self._needs.robot or len(self._arms) > 1  # their association starts from nominal kinematics
        recording, right = self._recording, self._needs.right_view
        encoded = recording.encoded_observations(robot=robot, right=right, rest=rest, stale=True)
        watches = [[AlarmWatch(alarms) for _ in self._places] for each in self._estimators for _ in each if alarms]
        with one_opencv_thread():
            count, total = 0, recording.image_count()
            for count, (decoded, conditions) in enumerate(in_order(self._prepare, encoded, jobs), 1):
                recording.record_losses(decoded)
                done = [replayed for unfinished in conditions for replayed in unfinished()]
                recording.on_progress(count, total)
                for at, of_instruments in enumerate(watches):
                    rows = zip(done[at].results, of_instruments, strict=True)
                    done[at] = replace(done[at], results=tuple(replace(row, alarm=one.watch(row)) for row, one in rows))
                yield tuple(done)
        if not count:
            start_s, end_s = recording.window.start_s, recording.window.end_s
            stamps_ns = image_stamps_ns(replace(recording, window=ALL_IMAGES))  # raises where the log has no image
            inside = f"from --start {start_s:g} to {'its end' if end_s == math.inf else f'--end {end_s:g}'}"
            length_s = round((max(stamps_ns) - stamps_ns[0]) * 1e-9, 3)
            raise RecordingError(f"{recording.name}: no image to measure {inside}: the log has {length_s:g} s")

    def _prepare(self, encoded: EncodedObservation) -> tuple[Decoded, list[Unfinished]]:
        """Whatever of a frame needs no other one."""
        decoded = encoded.decode()
        if isinstance(found := decoded.found, Rejection):
            every = [self._rejected(encoded, found)] * sum(map(len, self._estimators))
            return decoded, [lambda: every]
        return decoded, [self._look(at, encoded, found) for at in range(len(self._conditions))]

    def _rejected(self, encoded: EncodedObservation, why: Rejection) -> Replayed:
        number, seconds = encoded.number, encoded.at_ns * 1e-9
        row = FrameResult(why.stamp_ns, why.status, detail=why.detail, number=number, seconds=seconds)
        lost = tuple(replace(row, instrument=name) for name in self._recording.measured)
        return Replayed(lost, (0.0,) * len(lost))

    def _look(self, at: int, encoded: EncodedObservation, found: tuple[Observation, ...]) -> Unfinished:
        """One condition of a frame: its scene; of a single instrument its detections, and methods without state."""
        number, seconds = encoded.number, encoded.at_ns * 1e-9
        if looked := self._looked[at].pop(number, []):
            scene = looked[0].scene
        else:
            seen = self._conditions[at].apply(found[0], number)
            scene = Scene(seen, self._setup.profile, self._segmenter, self._rows)
        estimators, association = self._estimators[at], self._associations[at]
        stale: Replayed | None = None
        if encoded.repeats and _shows_instrument(scene):
            stale = self._rejected(encoded, Rejection(encoded.stamp_ns, Status.INCONSISTENT, encoded.repeats))
        spent_s = prefetch(scene, self._needs.scene)
        frames: list[Frame] = []
        measured: list[Replayed | None] = [None] * len(estimators)
        if association is None:
            each = zip(self._arms, found, strict=True)
            frames = looked or [Frame.of(scene, arm, one) for arm, one in each]
            spent_s |= prefetch(frames[0], self._needs.frame)
            measured = [None if one.keeps_state else one.estimate(frames, spent_s) for one in estimators]
        else:
            prefetch(scene, ("left.masks.seen", "right.masks.seen"))

        def finish() -> list[Replayed]:
            every = frames if association is None else association.frames(scene, found)
            chosen = [every[at] for at in self._places]
            done = []
            for estimator, known in zip(estimators, measured, strict=True):
                replayed = (stale if estimator.looks_for_tool else None) or known or estimator.estimate(chosen, spent_s)
                results = tuple(replace(one, number=number, seconds=seconds) for one in replayed.results)
                done.append(replace(replayed, results=results, image_bgr=found[0].image_bgr))
            return done

        return finish
