"""`svmdist validate`: score the estimates against kinematics and against the simulator's truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from svmdist.cli import output
from svmdist.cli.estimate import PictureOptions, log_ending
from svmdist.cli.logs import GoldenLogOptions, GroupOption, Run
from svmdist.cli.options import MeasureOptions, format_option, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.remote import LogPath
    from svmdist.workflows.request import Request, Setup

TruthChoice = StrEnum("TruthChoice", "ground_truth tf surface plane pose kinematics")
PlotKind = Literal["fig6", "time", "residuals", "bland-altman", "calibration"]


class Validate(GoldenLogOptions, MeasureOptions, GroupOption, PictureOptions):
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

    form: str | None = format_option(Holds.FIGURES)
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
    max_gap: float = option(
        "--max-gap SECONDS", "Longest gap to interpolate. Default: 0.1.", 0.1, min=0.0, max=60.0
    )
    baseline: Path | None = option("--baseline FILE", "Exit with 4 if a figure is worse than here.")
    write_baseline: Path | None = option("--write-baseline FILE", "Store the figures here.")
    plot: PlotKind | None = option(
        "--plot NAME",
        f"What --save-plot draws: {', '.join(get_args(PlotKind))}. Default: fig6, as in the paper.",
    )

    def _run(self) -> ExitCode:
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
        measure, kind_of = validate.score_recording, validate.Scored
        run = Run(self, measure, request, kind_of, "validating", "rows", (), keeps, keys)
        result = validate.combine(run.finish(), request, run.groups)
        lacking = {line for scored in run.results for line in scored.lacking}
        for note in result.notes:
            if note in lacking:
                LOG.error("loss: %s", note)
            else:
                LOG.info("note: %s", note)
        output.write_results(validation_results(result), writer, self.output)
        self.say_choice()
        log_ending({log.name: scored.ending for log, _, scored in run.measured}, request)
        self.draw(run, request, result, kind)
        code = max(run.exit_code(), ExitCode.LOSS if lacking else ExitCode.CLEAN)
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
