"""`svmdist validate`, `compare` and `blur-bench`: scores against the truth, methods side by side, and Table I."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from svmdist.cli import options, output
from svmdist.cli.logs import GroupOption, LogOptions, group_name
from svmdist.cli.measure import PictureOptions
from svmdist.cli.options import PLOT, argument, format_option, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.cli.jobs import Run
    from svmdist.remote import LogPath
    from svmdist.workflows.request import Request, Setup
    from svmdist.workflows.scoring.scores import Figures

TruthChoice = StrEnum("TruthChoice", "ground_truth tf surface plane pose kinematics")
PlotKind = Literal["fig6", "time", "residuals", "bland-altman", "calibration"]
MethodChoice = StrEnum("MethodChoice", "overlay centroid fiducial shaft stereo kinematic fused")


class ScoreOptions(LogOptions, options.ReadOptions, options.WindowOptions, options.OutputOptions):
    """What scores are made of, and where they go; without FILE, logs of recordings/ are scored."""

    files: list[str] | None = argument(  # type: ignore[assignment]
        None, "FILE", "Logs, folders, globs or URLs. Default: every .mcap in recordings/."
    )
    calibration: Path | None = options.CALIBRATION
    form: str | None = format_option(Holds.FIGURES)


def _exit_code(run: Run[Any], figures: Iterable[Figures]) -> ExitCode:
    """The exit code of a run with these figures; says where nothing was measured."""
    measured = any(one.measured_count for one in figures)
    if not measured:
        LOG.error("no frame is measured")
    return run.exit_code(measured)


class Validate(ScoreOptions, options.MeasureOptions, GroupOption, PictureOptions):
    """Score estimates against the truth.

    Each log is compared with the kinematics of its joint states, as in the paper, and with the simulator's ground
    truth; with --alarm-below, alarms are scored against the true clearance.

    Examples:
      Errors against the truth:
        svmdist validate log.mcap --method fused
      A page with plots and the worst frames:
        svmdist validate log.mcap --method fused --report report.html
      A figure for a paper:
        svmdist validate log.mcap --save-plot error.pdf --plot residuals
      Your own estimates in the same tables:
        svmdist validate log.mcap --estimates mine.csv
      In CI: fail where a figure gets worse:
        svmdist validate log.mcap --baseline baseline.json
    """

    truth: list[TruthChoice] | None = option(
        "--truth NAME",
        f"{', '.join(TruthChoice)}; plane and surface: tissue as images show it. Default: ground truth (else pose) and"
        " kinematics; may be repeated.",
    )
    estimates: str | None = option(
        "--estimates [NAME=]FILE",
        "Those of others, in place of a method: stamps with distances or poses (csv, parquet, tum), or topic:/NAME.",
    )
    truth_tf: list[str] | None = option(
        "--truth-tf PARENT:CHILD",
        "A transform that is the truth of tool or tissue, as in camera:tool; may be given twice.",
    )
    max_gap: float = option("--max-gap SECONDS", "Longest gap to interpolate. Default: 0.1.", 0.1, min=0.0, max=60.0)
    baseline: Path | None = option("--baseline FILE", "Exit with 4 if a figure is worse than here.")
    write_baseline: Path | None = option("--write-baseline FILE", "Store the figures here.")
    plot: PlotKind | None = option(
        "--plot NAME", f"What --save-plot draws: {', '.join(get_args(PlotKind))}. Default: fig6, as in the paper."
    )

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, log_ending
        from svmdist.report.scores import validation_results
        from svmdist.workflows import validate

        writer = self.writer(self.paths, Holds.FIGURES)
        output.require_output(self.write_baseline, self.paths)
        self.require_pictures(self.paths, self.plot)
        stored = validate.load_baseline(self.baseline) if self.baseline else None
        methods = {score.method for score in stored.scores} if stored else set()
        if self.method == "auto" and len(methods) == 1:
            (self.method,) = methods  # type: ignore[assignment]
        keys, request = self.group_keys, self.request(self.paths)
        if stored:
            validate.require_same_alarms(stored, request.alarms)
        validate.require_truth_for_alarms(request)
        kind = self.plot or "fig6"
        keeps = self.report is not None or (self.save_plot is not None and kind != "fig6")
        run = Run(self, validate.score_recording, request, validate.Scored, "validating", "images", (), keeps, keys)
        scored, groups = run.finish(), [group_name(one.metadata, keys) for _, one, _ in run.measured if keys]
        result = validate.combine(scored, request, groups)
        lacking = {line for one in scored for line in one.lacking}
        for note in result.notes:
            if note in lacking:
                LOG.error("loss: %s", note)
            else:
                LOG.info("note: %s", note)
        output.write_results(validation_results(result), writer, self.output)
        self.say_choice()
        log_ending({log.name: scored.ending for log, _, scored in run.measured}, request)
        self.draw(run, request, result, kind)
        code = max(_exit_code(run, result.scores), ExitCode.LOSS if lacking else ExitCode.CLEAN)
        if self.write_baseline:
            validate.save_baseline(validate.make_baseline(result), self.write_baseline)
        if stored:
            regressions = validate.find_regressions(result, stored, complete=not self.files)
            for regression in regressions:
                LOG.info("worse: %s", regression)
            if regressions:
                return ExitCode.WORSE
            LOG.info("no figure is worse than in %s", self.baseline)
        return code

    def setup(self, paths: Sequence[LogPath]) -> Setup:
        """What measures, or what others measured."""
        if self.estimates is None:
            return super().setup(paths)
        from svmdist.workflows.request import prepare
        from svmdist.workflows.scoring.given import given_estimates

        return prepare(self.profile, given_estimates(self.estimates), self.equations, None, self.hand_eye)

    def request(self, paths: Sequence[LogPath]) -> Request:
        """The measurement, and what it is scored against."""
        from svmdist.workflows.scoring.references import Reference, truth_rules

        request = super().request(paths)
        references = tuple(Reference(str(choice)) for choice in dict.fromkeys(self.truth or [])) or None
        pairs, max_gap_ns = tuple(self.truth_tf or ()), round(self.max_gap * 1e9)
        return replace(request, rules=truth_rules(pairs, request.setup.profile, references, max_gap_ns))


class Compare(ScoreOptions, options.LagOption, GroupOption):
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
        "--estimates [NAME=]FILE", "Also estimates of others, as in `validate`; may be repeated."
    )
    save_plot: Path | None = PLOT
    plot: Literal["compare"] | None = option("--plot", "What --save-plot draws.", hidden=True)

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, compare_log
        from svmdist.report.scores import compare_results
        from svmdist.vision.degradations import SEVERITIES, Degradation, require_degradation
        from svmdist.workflows.compare import MethodScore, compared
        from svmdist.workflows.request import CLEAN, Condition, Request, prepare, prepare_methods
        from svmdist.workflows.scoring.given import given_estimates, require_distinct

        writer = self.writer(self.paths, Holds.FIGURES)
        output.require_plot(self.save_plot, self.paths, self.plot)
        keys, lag = self.group_keys, self.given_lag
        conditions: list[Condition] = [CLEAN]
        for text in self.degrade or []:
            grid = [(str(name), severity) for name in Degradation for severity in SEVERITIES]
            for name, severity in grid if text == "all" else options.parse_degradations([text]):
                conditions.append(Condition(require_degradation(name, severity), severity))
        conditions += [Condition(world=world) for world in options.parse_perturbations(self.perturb)]
        conditions = list(dict.fromkeys(conditions))
        methods = list(dict.fromkeys(map(str, self.method or ())))
        given = [given_estimates(text) for text in self.estimates or []]
        require_distinct([*(methods or MethodChoice), *(one.name for one in given)])
        setups = prepare_methods(self.profile, self.calibration, self.hand_eye, methods)
        setups += tuple(prepare(self.profile, one, hand_eye=self.hand_eye) for one in given)
        request = Request(setups[0], self.topics, self.window, lag=lag, conditions=tuple(conditions))
        run = Run(self, compare_log, request, list[MethodScore], "comparing", options=(setups, keys), keys=keys)
        scores = compared([one for runs in run.finish() for one in runs])
        output.write_results(compare_results(scores), writer, self.output)
        if self.save_plot:
            from svmdist.report.plots import draw_compare, save_figure

            save_figure(self.save_plot, draw_compare, scores)
        return _exit_code(run, [score.figures for score in scores])


class BlurBench(ScoreOptions):
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

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run
        from svmdist.report.scores import blur_results
        from svmdist.vision.degradations import Blur
        from svmdist.workflows.compare import TABLE_I, BlurTally, blur_tallies
        from svmdist.workflows.request import Request, prepare

        writer = self.writer(self.paths, Holds.FIGURES)
        kernels_px = {blur: kernel_px for blur, (kernel_px, _) in TABLE_I.items()}
        blurs = [str(blur) for blur in Blur if blur is not Blur.NONE]
        for text in self.kernel or []:
            name, _, size = text.partition("=")
            if name not in blurs:
                raise UsageError(f"--kernel {text}: {did_you_mean(name, blurs)}")
            if not size.isdecimal() or int(size) % 2 == 0 or not 1 <= int(size) <= 101:
                raise UsageError(f"--kernel {text}: expected an odd size from 1 to 101 px, as in {name}=5")
            kernels_px[Blur(name)] = int(size)
        setup = prepare(self.profile, calibration=self.calibration, hand_eye=self.hand_eye)
        request = Request(setup, self.topics, self.window)
        run = Run(self, blur_tallies, request, list[BlurTally], "Table I", "images", (kernels_px,))
        tallies = run.finish()
        output.write_results(blur_results(tallies), writer, self.output)
        return _exit_code(run, [one.figures for of_log in tallies for one in of_log])
