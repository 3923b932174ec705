"""Compare: figures of methods on logs under conditions, against the truth and each other; and Table I, of blurs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from svmdist.perturbations.apply import nominal_profile
from svmdist.recording.log import Recording
from svmdist.recording.source import Health
from svmdist.recording.topics import Role
from svmdist.vision.colour import to_grey
from svmdist.vision.degradations import Blur
from svmdist.vision.marker import EDGE_MARGIN_PX, detect_orb, paste_marker
from svmdist.workflows import parallel
from svmdist.workflows.capabilities import served_setups
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import CLEAN, Condition, Request, Setup
from svmdist.workflows.scoring.given import require_distinct
from svmdist.workflows.scoring.references import ANY_TRUTH, Reference, Truth, reference_lag_ns, truth_at
from svmdist.workflows.scoring.scores import Figures, Readings, figures_of, pooled_figures

GroupBy = Callable[[Mapping[str, str]], str]  # names the group of a recording by its metadata

ALL = "all"
CHUNKS_PER_PROCESS = 2
"""Conditions are dealt out in so many parts a process: each part decodes the images once more, few parts wait."""

WITH_FUSED = ("fused", "fiducial")
"""Where methods are shared by two processes: `fused` takes as long as most others together, and finds tags already.
`shaft` and `stereo` share the pose by the shaft's edges, which is what they spend most on."""


@dataclass(frozen=True, slots=True)
class Group:
    """Frames that are compared together: those of a scenario and a degradation, or of `all` of them."""

    scenario: str
    degradation: str = ""  # as in `smoke=3`, `focal=1`, `world=real`
    other_instrument: str = ""  # one that is not its recording's first

    def __str__(self) -> str:
        degradation = "" if self.degradation == ALL else self.degradation
        return " ".join(filter(None, (self.scenario, degradation, self.other_instrument)))


@dataclass(frozen=True)
class MethodScore:
    """One method on one group of frames, and the instrument that it measured."""

    group: Group
    method: str
    figures: Figures
    instrument: str = ""
    against: str = ""
    """Another method, where it is not the truth: with the joint deviation, on the frames that both measured."""


def compare(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    jobs: int | None = None,
) -> list[MethodScore]:
    """Run every setup on every recording under every condition; raises what `measure_runs` does."""
    require_distinct([setup.method for setup in setups])
    return compared([run for one in recordings for run in measure_runs(one, setups, conditions, jobs=jobs)])


def measure_runs(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    jobs: int | None = None,
    by: GroupBy | None = None,
) -> list[MethodScore]:
    """A score for every condition, setup and instrument of a recording, in that order.

    Then the differences of two methods: of all where the log has no ground truth, else of those of others from ours.
    Processes share conditions or methods; `jobs` threads work ahead where nothing can be shared. `by` groups by other
    metadata than the scenario. A method that the log cannot serve is left out, with a remark; another instrument than
    the first where it has no truth that the first has. RecordingError without ground truth and anything to compare.
    """
    jobs = parallel.usable_cores() if jobs is None else jobs
    first, role = recording.instruments[0], Role.GROUND_TRUTH_DISTANCE
    known = tuple(name for name in recording.instruments if recording.for_instrument(name).topic_of(role) is not None)
    if first not in known and len(setups) == 1:
        recording.for_instrument(first).distance_track()  # raises
    names = known if first in known else recording.instruments
    setups = [setup.for_log(recording) for setup in served_setups(recording, setups)]
    parts = _parts(setups, conditions, 1 if parallel.is_worker() else jobs)
    work = partial(_measured, replace(recording, wanted=names), conditions, setups, max(1, jobs // len(parts)))
    images = recording.image_count()
    total = images and images * sum(len(passes) for passes, _ in parts)
    workers, on_step = min(jobs, len(parts)), lambda done: recording.on_progress(done, total)
    ended = [made for _, made in parallel.each_in_processes(work, parts, workers, on_step=on_step)]
    # Methods that need both views lose what others lose, and right images: their list has all in file order.
    for _, health in sorted(ended, key=lambda one: -len(one[1].losses)):
        recording.health.join(health)
    found = {place: rows for of_part, _ in ended for place, rows in of_part.items()}
    methods, scores = [setup.method for setup in setups], []
    for (at, of, name), (rows, truth, seconds) in sorted(found.items(), key=lambda one: one[0][:2]):
        group = group_of(recording, conditions[at], name, by)
        scores.append(MethodScore(group, methods[of], replace(figures_of(rows, truth), seconds=seconds), name))
        for place in range(of + 1, len(setups)):
            if truth is None or setups[of].is_given != setups[place].is_given:
                differences = figures_of(found[at, place, name][0], rows.truth, rows)
                scores.append(MethodScore(group, methods[place], differences, name, methods[of]))
    return sorted(scores, key=lambda score: bool(score.against))


Part = tuple[list[list[int]], Sequence[int]]  # what one process measures: its passes, of conditions, and its setups
Found = dict[tuple[int, int, str], tuple[Readings, Truth | None, float]]
"""Rows, what is true of them where that is known, and seconds, by the places of condition and setup, and instrument."""


def _parts(setups: Sequence[Setup], conditions: Sequence[Condition], jobs: int) -> list[Part]:
    """Deal work out by conditions, and by methods where they are few: each part reads the log once more."""
    every, chunks = range(len(conditions)), []
    size = -(-len(every) // (CHUNKS_PER_PROCESS * jobs)) if jobs > 1 else len(every)
    for places in (every[start : start + size] for start in every[::size]):
        # A pass over the log is of all conditions of its images together, or of one perturbed world.
        images = [at for at in places if not conditions[at].world]
        chunks.append([at for at in (images, *([at] for at in places if conditions[at].world)) if at])
    groups: list[Sequence[int]] = [range(len(setups))]
    if len(chunks) < jobs:
        with_fused = [at for at, setup in enumerate(setups) if setup.method in WITH_FUSED]
        rest = [at for at in range(len(setups)) if at not in with_fused]
        groups = [group for group in (with_fused, rest) if group]
    return [(chunk, group) for chunk in chunks for group in groups]


def _measured(
    recording: Recording, conditions: Sequence[Condition], setups: Sequence[Setup], threads: int, part: Part
) -> tuple[Found, Health]:
    """What a part shows, measured by so many threads, and what was lost on the way."""
    found: Found = {}
    for places in part[0]:
        read, of_pass, chosen = recording, [conditions[at] for at in places], [setups[of] for of in part[1]]
        if parallel.is_worker():
            read = replace(read, on_progress=parallel.step)
        if world := of_pass[0].world:  # it has a pass of its own
            read = read.perturbed(world)
            # The profile is wrong about instrument, tag and plane.
            chosen = [replace(one, profile=nominal_profile(one.profile, world, read.world.seed)) for one in chosen]
        keys = [(at, of, name) for at in places for of in part[1] for name in read.measured]
        readings, seconds = {key: Readings() for key in keys}, dict.fromkeys(keys, 0.0)
        for replayed in replay(read, chosen, of_pass, jobs=threads):
            results = [pair for one in replayed for pair in zip(one.results, one.seconds, strict=True)]
            for key, (result, spent_s) in zip(keys, results, strict=True):
                readings[key].add(result)
                seconds[key] += spent_s
        for key, rows in readings.items():
            own, truth = read.for_instrument(key[2]), None
            if own.topic_of(Role.GROUND_TRUTH_DISTANCE) is not None:
                at_ns = rows.stamps_ns - reference_lag_ns(own, Reference.GROUND_TRUTH, read.lag)
                truth = truth_at(own, Reference.GROUND_TRUTH, at_ns, "corrected", ANY_TRUTH)
            found[key] = rows, truth, np.nan if setups[key[1]].is_given else seconds[key]
    return found, recording.health


def group_of(
    recording: Recording, condition: Condition = CLEAN, instrument: str = "", by: GroupBy | None = None
) -> Group:
    """What a recording is compared as: its scenario, or its name, and its degradations; or by other metadata."""
    metadata = recording.metadata
    other = instrument if instrument in recording.instruments[1:] else ""
    if by is not None:
        return Group(by(metadata), str(condition), other)
    world = f"world={metadata['world']}" if "world" in metadata else metadata.get("perturb", "")
    # What it was recorded with (of a real world only that is said), and then what is done to it now.
    degradations = (metadata.get("degrade", ""), world, str(condition))
    return Group(metadata.get("scenario", recording.name), ",".join(filter(None, degradations)), other)


def compared(runs: Sequence[MethodScore]) -> list[MethodScore]:
    """Scores by group, by degradation over all scenarios where both differ, and over all."""
    kinds = {(run.group.scenario, run.group.degradation) for run in runs}
    scores = _pooled(runs, [run.group for run in runs])
    if all(len(set(several)) > 1 for several in zip(*kinds, strict=True)):
        groups = [replace(run.group, scenario=ALL, degradation=run.group.degradation or "clean") for run in runs]
        scores += _pooled(runs, groups)
    if len(kinds) > 1:
        groups = [replace(run.group, scenario=ALL, degradation=ALL) for run in runs]
        scores += _pooled(runs, groups)
    return scores


def _pooled(runs: Sequence[MethodScore], groups: Sequence[Group]) -> list[MethodScore]:
    """The scores of each group of runs, in the order of the methods: that of the first runs."""
    order = list(dict.fromkeys(groups))
    members = defaultdict[tuple[Group, str, str], list[MethodScore]](list)
    for run, group in zip(runs, groups, strict=True):
        members[group, run.against, run.method].append(replace(run, group=group))
    pooled = [replace(of[0], figures=pooled_figures([run.figures for run in of])) for of in members.values()]
    return sorted(pooled, key=lambda one: (order.index(one.group), bool(one.against)))


TABLE_I: Mapping[Blur, tuple[int, tuple[int, int] | None]] = {
    Blur.NONE: (1, None),
    Blur.EROSION: (3, (7, 221)),
    Blur.DILATION: (3, (2, 219)),
    Blur.GAUSSIAN: (5, (7, 215)),
    Blur.MEDIAN: (5, (3, 215)),
    Blur.BILATERAL: (9, (3, 218)),
}
"""Each blur's kernel in px, and its row in the paper as published: features, and the contour's area in px.

The paper states no kernels. These are the smallest usual ones: an instrument region is some 15 px across.
"""

Counts = tuple[int | None, int | None, int | None, int | None, int | None]
"""Keypoints and area in px of the instrument alone; keypoints in the marker's window, matches and inliers."""


@dataclass(frozen=True)
class BlurTally:
    """What one blur did to the frames of a log, or of several: figures, and the counts of each frame."""

    blur: Blur
    kernel_px: int
    figures: Figures
    counts: list[Counts]

    @property
    def means(self) -> list[float | None]:
        """The mean of each count over the frames that have it; None where none has."""
        known = [[count for count in of if count is not None] for of in zip(*self.counts, strict=True)]
        return [float(np.mean(of)) if of else None for of in known]

    @property
    def published(self) -> tuple[int, int] | None:
        """The row of the paper's Table I; None where it has none."""
        return TABLE_I[self.blur][1]


def blur_tallies(
    recording: Recording, request: Request, jobs: int | None, kernels_px: Mapping[Blur, int]
) -> list[BlurTally]:
    """Degrade each frame by every blur, paste the marker behind it, measure and count."""
    readings = {blur: Readings() for blur in kernels_px}
    counts: dict[Blur, list[Counts]] = {blur: [] for blur in kernels_px}
    conditions = [Condition(blur, kernel_px) for blur, kernel_px in kernels_px.items()]
    recording = replace(recording, wanted=recording.instruments[:1])
    for replayed in replay(recording, [request.setup], conditions, jobs=jobs):
        for blur, one in zip(kernels_px, replayed, strict=True):
            readings[blur].add(one.results[0])
            counts[blur].append(_counts(one))
    truth_m = recording.distance_track().at(readings[Blur.NONE].stamps_ns).values
    return [
        BlurTally(blur, kernels_px[blur], figures_of(rows, Truth(truth_m)), counts[blur])
        for blur, rows in readings.items()
    ]


def pooled_tallies(parts: Sequence[Sequence[BlurTally]]) -> list[BlurTally]:
    """The tallies of several recordings together, by blur."""
    pooled = []
    for of_blur in zip(*parts, strict=True):
        figures = pooled_figures([one.figures for one in of_blur])
        pooled.append(replace(of_blur[0], figures=figures, counts=[frame for one in of_blur for frame in one.counts]))
    return pooled


def _counts(one: Replayed) -> Counts:
    """The counts of one image; None of one that could not be read, or without an instrument."""
    instrument = one.frames[0].left.regions_as_recorded[1] if one.frames else None
    if instrument is None:
        return (None,) * 5
    (frame,), (result,) = one.frames, one.results
    profile, context = frame.arm.profile, frame.left.context
    size_px, feature_count = profile.marker.size_px, profile.features.feature_count
    marked_bgr, _ = paste_marker(context.bgr_as_recorded, instrument.centroid_px, size_px, EDGE_MARGIN_PX)
    points_px = detect_orb(to_grey(marked_bgr), feature_count).points_px - EDGE_MARGIN_PX
    return (
        len(detect_orb(context.grey, feature_count, frame.left.masks_as_recorded.instrument)),
        instrument.area_px,
        int(np.count_nonzero(np.all((points_px >= 0) & (points_px < size_px), axis=1))),
        result.image.match_count,
        result.image.inlier_count,
    )
