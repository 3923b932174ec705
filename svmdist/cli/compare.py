"""`svmdist compare` and `blur-bench`: methods side by side, images degraded and worlds perturbed; Table I, measured."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from svmdist.cli.estimate import corrected
from svmdist.cli.logs import Logs
from svmdist.cli.options import (
    PLOT,
    CalibrationOption,
    GoldenLogOptions,
    GroupOption,
    LagOption,
    ReadOptions,
    WindowOptions,
    format_option,
    group_name,
    option,
    output_option,
    parse_degradations,
    parse_perturbations,
)
from svmdist.cli.output import progress_bar, require_output, require_plot, write_results
from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.blur_bench import BlurTally
    from svmdist.workflows.compare import MethodScore
    from svmdist.workflows.request import LogCondition, Request, Setup


MethodChoice = StrEnum("MethodChoice", "overlay centroid fiducial shaft stereo kinematic fused")
ComparePlot = Literal["compare"]


class CompareOptions(GoldenLogOptions, CalibrationOption, ReadOptions, LagOption, WindowOptions, GroupOption):
    """What `compare` takes."""

    method: list[MethodChoice] | None = option(
        None, f"--method {'|'.join(MethodChoice)}", "A method to compare; may be repeated. Default: all."
    )
    degrade: list[str] | None = option(
        None,
        "--degrade NAME=SEVERITY|all",
        "Also measure with the images degraded, as in smoke=3; all stands for every degradation at every severity."
        " May be repeated; each is applied alone.",
    )
    perturb: list[str] | None = option(
        None,
        "--perturb NAME=STRENGTH",
        "Also measure in a world that is not as log and profile say, as in focal=1 or lag=30. May be "
        "repeated; each is applied alone, NAME=STRENGTH,NAME=STRENGTH together. Names: docs/simulation.md.",
    )
    form: str | None = format_option(Holds.FIGURES)
    output: Path | None = output_option()
    save_plot: Path | None = PLOT
    plot: ComparePlot | None = option(None, "--plot", "What --save-plot draws.", hidden=True)

    @property
    def conditions(self) -> list[LogCondition]:
        """The images as recorded, and what else is asked for; raises UsageError."""
        from svmdist.vision.degradations import SEVERITIES, Degradation, require_degradation
        from svmdist.workflows.request import CLEAN, Condition, PerturbedCondition

        conditions: list[LogCondition] = [CLEAN]
        for text in self.degrade or []:
            grid = [(str(name), severity) for name in Degradation for severity in SEVERITIES]
            chosen = grid if text == "all" else parse_degradations("--degrade", [text])
            conditions += [
                Condition(require_degradation(name, severity), severity) for name, severity in chosen
            ]
        conditions += [PerturbedCondition(world) for world in parse_perturbations("--perturb", self.perturb)]
        return list(dict.fromkeys(conditions))


def compare_command(given: CompareOptions) -> None:
    """Compare methods on the same frames.

    Error and coverage of each method are given per scenario, and over all of them. Every method measures the same
    frames; each image is decoded once. Without FILE, every log in recordings/ is compared.

    Examples:
      All methods on the same frames:
        svmdist compare log.mcap
      Two of them, also in smoke:
        svmdist compare log.mcap --method fused --method shaft --degrade smoke=3
      One of them under every degradation and severity:
        svmdist compare log.mcap --method fused --degrade all
      A table and a figure for a paper:
        svmdist compare log.mcap -f latex --save-plot methods.pdf
    """
    from svmdist.report.scores import compare_results
    from svmdist.workflows.batch import Job
    from svmdist.workflows.compare import MethodScore, compared
    from svmdist.workflows.request import Request, prepare

    logs = Logs(given)
    require_output(given.output, logs.paths)
    require_plot(given.save_plot, logs.paths, given.plot)
    writer = choose_writer(given.form, given.output, Holds.FIGURES)
    keys, lag = given.group_keys, given.given_lag
    conditions = given.conditions
    planar = ("overlay", "centroid")
    methods = list(dict.fromkeys(map(str, given.method or MethodChoice)))
    files = {method: given.calibration if method in planar else None for method in methods}
    setups = tuple(
        prepare(given.profile, method, "corrected", files[method], given.hand_eye) for method in methods
    )
    request = Request(setups[0], given.topics, given.window, lag=lag, conditions=tuple(conditions))
    run = logs.run(Job(compare_log, request, list[MethodScore], (setups, keys)), "comparing")
    scores = compared([one for runs in run.results for one in runs], [one.method for one in setups])
    write_results(compare_results(scores), writer, given.output)
    if given.save_plot:
        from svmdist.report.plots import draw_compare, save_figure

        save_figure(given.save_plot, draw_compare, scores)
    raise typer.Exit(run.exit_code())


def compare_log(
    recording: Recording, request: Request, threads: int, setups: tuple[Setup, ...], keys: tuple[str, ...]
) -> list[MethodScore]:
    """Measure a log with several methods under several conditions, with progress."""
    from svmdist.workflows.compare import measure_runs
    from svmdist.workflows.parallel import Steps, image_total

    seen = corrected(recording, request, threads)
    by = partial(group_name, keys=keys) if keys else None
    with progress_bar("comparing", "measurements") as advance:
        total = image_total([recording], lambda _: len(request.conditions) * len(setups))
        steps = Steps(advance, total)
        return measure_runs(seen, setups, request.conditions, jobs=threads, by=by, advance=steps.advance)


class BlurOptions(GoldenLogOptions, CalibrationOption, ReadOptions, WindowOptions):
    """What `blur-bench` takes."""

    kernel: list[str] | None = option(
        None, "--kernel BLUR=PX", "Kernel size of one blur, an odd number; may be repeated."
    )
    form: str | None = format_option(Holds.FIGURES)
    output: Path | None = output_option()


def blur_bench_command(given: BlurOptions) -> None:
    """Measure features and error under blur.

    This reproduces Table I of the paper with its method, overlay. For other methods and degradations see
    `svmdist compare --degrade all`. Without FILE, every log in recordings/ is measured.

    Examples:
      Table I of the paper, measured:
        svmdist blur-bench log.mcap
      Every fifth image, with a larger Gaussian:
        svmdist blur-bench log.mcap --every 5 --kernel gaussian=9
    """
    from svmdist.report.scores import blur_results
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.batch import Job
    from svmdist.workflows.blur_bench import BlurTally, blur_rows
    from svmdist.workflows.request import Request, prepare

    logs = Logs(given)
    require_output(given.output, logs.paths)
    writer = choose_writer(given.form, given.output, Holds.FIGURES)
    kernels_px = _kernels(given.kernel or [])
    setup = prepare(given.profile, "overlay", "corrected", given.calibration, given.hand_eye)
    request = Request(setup, given.topics, given.window)
    run = logs.run(Job(blur_log, request, dict[Blur, BlurTally], (kernels_px,)), "measuring")
    measured = blur_rows(run.results, kernels_px)
    write_results(blur_results(measured, len(run.results)), writer, given.output)
    raise typer.Exit(run.exit_code())


def blur_log(
    recording: Recording, request: Request, threads: int, kernels_px: dict[Blur, int]
) -> dict[Blur, BlurTally]:
    """Measure a log under every blur, with progress."""
    from svmdist.workflows.blur_bench import blur_tallies
    from svmdist.workflows.parallel import Steps

    with progress_bar("Table I", "images") as advance:
        steps = Steps(advance, recording.image_count())
        return blur_tallies(recording, request.setup, kernels_px, threads, steps.advance)


def _kernels(options: list[str]) -> dict[Blur, int]:
    """Parse BLUR=PX over the default kernels; raises UsageError that says what was expected."""
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.blur_bench import DEFAULT_KERNELS_PX

    kernels_px = dict(DEFAULT_KERNELS_PX)
    blurs = [str(blur) for blur in Blur if blur is not Blur.NONE]
    for text in options:
        name, _, size = text.partition("=")
        if name not in blurs:
            raise UsageError(f"--kernel {text}: {did_you_mean(name, blurs)}")
        if not size.isdecimal() or int(size) % 2 == 0 or not 1 <= int(size) <= 101:
            raise UsageError(f"--kernel {text}: expected an odd size from 1 to 101 px, as in {name}=5")
        kernels_px[Blur(name)] = int(size)
    return kernels_px
