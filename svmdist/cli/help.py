"""How help looks: what a command does, examples, then its options by what they are for. As wide as the terminal."""

from __future__ import annotations

from typing import Any

PANELS = {
    "Input": "files file source right pattern right_pattern side_by_side topic joints profile hand_eye start end every"
    " rate times poses joint_names crop",
    "Camera": "camera_file right_calibration calibrated_at camera right_camera distortion distortion_model"
    " baseline_length unit",
    "Scene": "scenario seed duration images_per_second stereo tag arms",
    "Errors and degradations": "degrade perturb kernel noise kinematic_error world",
    "Method": "method calibration equations instrument lag alarm_below alarm_when against estimates in_camera",
    "Truth": "truth truth_tf max_gap",
    "Images": "masks frame at worst",
    "Output": "output form report save_plot plot summary force jpeg name",
    "Regressions": "baseline write_baseline",
    "Processes, many logs": "jobs scheduler resume group episodes skip_existing",
    "General": "quiet verbose version install_completion show_completion help",
}
"""Headings, and the parameters below each in their order."""
NAMES_WIDTH = 26
WIDEST = 140


class Helped:
    """Commands, and groups of them, with this help."""

    def format_options(self: Any, ctx: Any, formatter: Any) -> None:
        """Write the examples, the commands of a group, and the options under their headings."""
        self._write(self.epilog.partition("\n\n")[0], formatter)
        if hasattr(self, "format_commands"):
            self.format_commands(ctx, formatter)
        given = {one.name: (_names(one), one.help) for one in self.get_params(ctx) if not one.hidden}
        width = max(len(names) for names, _ in given.values() if len(names) <= NAMES_WIDTH)
        for heading, members in PANELS.items():
            if found := [given[name] for name in members.split() if name in given]:
                with formatter.section(heading):  # padded, so that all texts begin at one column
                    formatter.write_dl([(names.ljust(width), text) for names, text in found], width)

    def format_epilog(self: Any, _ctx: Any, formatter: Any) -> None:
        """Write what stands behind the examples."""
        self._write(self.epilog.partition("\n\n")[2], formatter)

    def _write(self, text: str, formatter: Any) -> None:
        if text:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(text)


def _names(parameter: Any) -> str:
    """What a parameter is called, and what stands for its value."""
    if parameter.param_type_name == "argument":
        return f"{parameter.metavar}{'...' * (parameter.nargs != 1)}"
    return " ".join(filter(None, (", ".join(sorted(parameter.opts, key=len)), parameter.metavar)))
