"""`svmdist compare` and `blur-bench`: methods side by side, images degraded and worlds perturbed; Table I, measured."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from svmdist.cli import options, output
from svmdist.cli.estimate import corrected
from svmdist.cli.logs import GoldenLogOptions, GroupOption, Run, group_name
from svmdist.cli.options import PLOT, CalibrationOption, LagOption, OutputOptions, WindowOptions, option
from svmdist.cli.output import ExitCode
from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.compare import MethodScore
    from svmdist.workflows.request import Condition, Request, Setup

MethodChoice = StrEnum("MethodChoice", "overlay centroid fiducial shaft stereo kinematic fused")


class Compare(GoldenLogOptions, CalibrationOption, LagOption, WindowOptions, GroupOption, OutputOptions):
    """Compare methods on the same frames.

    Error and coverage of each method are given per scenario, and over all of them. Every method that a log can serve
    measures the same frames; each image is decoded once. Methods stand against each other, too, where a log has no
    ground truth, or --estimates gives those of others. Without FILE, every log in recordings/ is compared.

    Examples:
      All methods on the same frames:
        svmdist compare log.mcap
      Two of them, also in smoke:
        svmdist compare log.mcap --method fused --method shaft --degrade smoke=3
      One of them under every degradation and severity:
        svmdist compare log.mcap --method fused --degrade all
      Yours beside ours:
        svmdist compare log.mcap --method fused --estimates mine=poses.tum
      A table and a figure for a paper:
        svmdist compare log.mcap -f latex --save-plot methods.pdf
    """

    method: list[MethodChoice] | None = option(
        "--method NAME", f"{', '.join(MethodChoice)}; may be repeated. Default: all."
    )
    degrade: list[str] | None = option(
        "--degrade NAME=SEVERITY",
        "Also with images degraded, as in smoke=3, or all for every one; each alone; may be repeated.",
    )
    perturb: list[str] | None = option(
        "--perturb NAME=STRENGTH",
        "Also in a world other than log and profile say, as in focal=1; each alone, focal=1,lag=30 together; may be"
        " repeated. Names: docs/simulation.md.",
    )
    estimates: list[str] | None = option(
        "--estimates [NAME=]FILE",
        "Also estimates of others, as in `validate`; may be repeated.",
    )
    form: str | None = options.format_option(Holds.FIGURES)
    save_plot: Path | None = PLOT
    plot: Literal["compare"] | None = option("--plot", "What --save-plot draws.", hidden=True)

    def _run(self) -> ExitCode:
        from svmdist.report.scores import compare_results
        from svmdist.workflows.compare import MethodScore, compared
        from svmdist.workflows.request import Request, prepare, prepare_every
        from svmdist.workflows.scoring.given import given_estimates, require_distinct

        writer = self.writer(self.paths, Holds.FIGURES)
        output.require_plot(self.save_plot, self.paths, self.plot)
        keys, lag, conditions = self.group_keys, self.given_lag, self.conditions
        methods = list(dict.fromkeys(map(str, self.method or MethodChoice)))
        given = [given_estimates(text) for text in self.estimates or []]
        require_distinct([*methods, *(one.name for one in given)])
        calibrations = {"overlay": self.calibration, "centroid": self.calibration}
        if self.method:
            of = partial(prepare, self.profile, equations="corrected", hand_eye=self.hand_eye)
            setups = tuple(of(method, calibration=calibrations.get(method)) for method in methods)
        else:
            setups = prepare_every(self.profile, self.calibration, self.hand_eye)
        setups += tuple(prepare(self.profile, one, hand_eye=self.hand_eye) for one in given)
        request = Request(setups[0], self.topics, self.window, lag=lag, conditions=tuple(conditions))
        run = Run(
            self, compare_log, request, list[MethodScore], "comparing", options=(setups, keys), keys=keys
        )
        scores = compared([one for runs in run.finish() for one in runs])
        output.write_results(compare_results(scores), writer, self.output)
        if self.save_plot:
            from svmdist.report.plots import draw_compare, save_figure

            save_figure(self.save_plot, draw_compare, scores)
        return run.exit_code()

    @property
    def conditions(self) -> list[Condition]:
        """The images as recorded, and what else is asked for; raises UsageError."""
        from svmdist.vision.degradations import SEVERITIES, Degradation, require_degradation
        from svmdist.workflows.request import CLEAN, Condition

        conditions: list[Condition] = [CLEAN]
        for text in self.degrade or []:
            grid = [(str(name), severity) for name in Degradation for severity in SEVERITIES]
            for name, severity in grid if text == "all" else options.parse_degradations([text]):
                conditions.append(Condition(require_degradation(name, severity), severity))
        conditions += [Condition(world=world) for world in options.parse_perturbations(self.perturb)]
        return list(dict.fromkeys(conditions))


def compare_log(
    recording: Recording, request: Request, threads: int, setups: tuple[Setup, ...], keys: tuple[str, ...]
) -> list[MethodScore]:
    """Measure a log with several methods under several conditions, with progress."""
    from svmdist.workflows.compare import measure_runs

    seen = corrected(recording, request, threads)
    by = partial(group_name, keys=keys) if keys else None
    each = len(request.conditions) * len(setups)
    with output.steps("comparing", "measurements", recording.image_count(), each) as steps:
        return measure_runs(seen, setups, request.conditions, jobs=threads, by=by, advance=steps.advance)


class BlurBench(GoldenLogOptions, CalibrationOption, WindowOptions, OutputOptions):
    """Measure features and error under blur.

    This reproduces Table I of the paper with its method, overlay. For other methods and degradations see
    `svmdist compare --degrade all`. Without FILE, every log in recordings/ is measured.

    Examples:
      Table I of the paper, measured:
        svmdist blur-bench log.mcap
      Every fifth image, with a larger Gaussian:
        svmdist blur-bench log.mcap --every 5 --kernel gaussian=9
    """

    kernel: list[str] | None = option("--kernel BLUR=PX", "An odd size, as in gaussian=9; may be repeated.")
    form: str | None = options.format_option(Holds.FIGURES)

    def _run(self) -> ExitCode:
        from svmdist.report.scores import blur_results
        from svmdist.vision.degradations import Blur
        from svmdist.workflows.blur_bench import BlurTally, blur_rows, blur_tallies
        from svmdist.workflows.request import Request, prepare

        writer = self.writer(self.paths, Holds.FIGURES)
        kernels_px = self._kernels_px()
        setup = prepare(self.profile, calibration=self.calibration, hand_eye=self.hand_eye)
        request = Request(setup, self.topics, self.window)
        run = Run(self, blur_tallies, request, dict[Blur, BlurTally], "Table I", "images", (kernels_px,))
        tallies = run.finish()
        output.write_results(blur_results(blur_rows(tallies, kernels_px), len(tallies)), writer, self.output)
        return run.exit_code()

    def _kernels_px(self) -> dict[Blur, int]:
        """The kernels by blur, those of the paper where none is given; raises UsageError."""
        from svmdist.vision.degradations import Blur
        from svmdist.workflows.blur_bench import DEFAULT_KERNELS_PX

        kernels_px = dict(DEFAULT_KERNELS_PX)
        blurs = [str(blur) for blur in Blur if blur is not Blur.NONE]
        for text in self.kernel or []:
            name, _, size = text.partition("=")
            if name not in blurs:
                raise UsageError(f"--kernel {text}: {did_you_mean(name, blurs)}")
            if not size.isdecimal() or int(size) % 2 == 0 or not 1 <= int(size) <= 101:
                raise UsageError(f"--kernel {text}: expected an odd size from 1 to 101 px, as in {name}=5")
            kernels_px[Blur(name)] = int(size)
        return kernels_px
