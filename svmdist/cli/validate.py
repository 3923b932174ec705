"""`svmdist validate`: score the estimates against kinematics and against the simulator's truth."""

from __future__ import annotations

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
    from svmdist.workflows.request import Request

TruthChoice = StrEnum("TruthChoice", "ground_truth tf pose kinematics")
PlotKind = Literal["fig6", "time", "residuals", "bland-altman", "calibration"]


class Validate(GoldenLogOptions, MeasureOptions, GroupOption, PictureOptions):
    """Score estimates against the truth.

    Without FILE, every log in recordings/ is scored. Each recording is compared with the DH kinematics of its joint
    states, as in the paper, and with the simulator's ground truth. With --alarm-below, alarms are scored against
    the true clearance: recall, precision, share of the safe frames that are alarmed, false alarms per minute and
    lead time.

    Examples:
      Errors against the truth:
        svmdist validate log.mcap --method fused
      A page with plots and the worst frames:
        svmdist validate log.mcap --method fused --report report.html
      A figure for a paper:
        svmdist validate log.mcap --save-plot error.pdf --plot residuals
      In CI: fail where a figure gets worse:
        svmdist validate log.mcap --baseline baseline.json
    """

    form: str | None = format_option(Holds.FIGURES)
    truth: list[TruthChoice] | None = option(
        f"--truth {'|'.join(TruthChoice)}",
        "Reference to compare with; may be repeated. Default: every reference that the log has.",
    )
    truth_tf: list[str] | None = option(
        "--truth-tf PARENT:CHILD",
        "Transform that is the truth of the tool or the tissue, as in camera:tool; may be given twice.",
    )
    max_gap: float = option(
        "--max-gap SECONDS", "Longest gap in the truth to interpolate.", 0.1, min=0.0, max=60.0
    )
    baseline: Path | None = option("--baseline FILE", "Exit with 4 if a metric is worse than in this file.")
    write_baseline: Path | None = option("--write-baseline FILE", "Store the metrics in this file.")
    plot: PlotKind | None = option(
        f"--plot {'|'.join(get_args(PlotKind))}",
        "What --save-plot draws: fig6, truth, estimate and error over time as in the paper's figure; time, the distance"
        " with its interval; residuals over time and distance; bland-altman; calibration of the interval. Default:"
        " fig6.",
    )

    def _run(self) -> ExitCode:
        from svmdist.report.scores import validation_results
        from svmdist.workflows import validate

        writer = self.writer(self.paths, Holds.FIGURES)
        output.require_output(self.write_baseline, self.paths)
        self.require_pictures(self.paths, self.plot)
        keys, request = self.group_keys, self.request()
        stored = validate.load_baseline(self.baseline) if self.baseline else None
        if stored:
            validate.require_same_alarms(stored, request.alarms)
        validate.require_truth_for_alarms(request)
        kind = self.plot or "fig6"
        keeps = self.report is not None or (self.save_plot is not None and kind != "fig6")
        measure, kind_of = validate.score_recording, validate.Scored
        run = Run(self, measure, request, kind_of, "validating", "rows", (), keeps, keys)
        result = validate.combine(run.finish(), request, run.groups)
        for note in result.notes:
            LOG.info("note: %s", note)
        output.write_results(validation_results(result), writer, self.output)
        log_ending({log.name: scored.ending for log, _, scored in run.measured}, request)
        self.draw(run, request, result, kind)
        code = run.exit_code()
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

    def request(self) -> Request:
        """The measurement, and what it is scored against."""
        from svmdist.workflows.references import Reference, truth_rules

        request = super().request()
        references = tuple(Reference(str(choice)) for choice in dict.fromkeys(self.truth or [])) or None
        pairs, max_gap_ns = tuple(self.truth_tf or ()), round(self.max_gap * 1e9)
        return replace(request, rules=truth_rules(pairs, request.setup.profile, references, max_gap_ns))
