"""The options about alarms, and the rules they ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.options import parse_length_m
from svmdist.errors import UsageError

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules

AlarmBelowOption = Annotated[
    str | None,
    typer.Option(
        "--alarm-below",
        metavar="LENGTH",
        help="Raise an alarm where the clearance is below this, as in 5mm. For methods that estimate a clearance.",
        show_default=False,
    ),
]
AlarmConfidenceOption = Annotated[
    float | None,
    typer.Option(
        "--alarm-confidence",
        metavar="P",
        help="Alarm where the clearance is below the threshold with at least this probability."
        " Default 0.05: alarm unless the frame is safe with 95 % probability.",
        min=0.0,
        max=1.0,
        show_default=False,
    ),
]


def alarm_rules(below: str | None, confidence: float | None, method: str) -> AlarmRules | None:
    """The rules that the options ask for, None without a threshold; raises UsageError.

    A confidence without a threshold is refused, and so is a method that estimates no clearance.
    """
    if below is None:
        if confidence is not None:
            raise UsageError("--alarm-confidence is for --alarm-below LENGTH, as in --alarm-below 5mm")
        return None
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.workflows.scoring.score import require_clearance

    below_m = parse_length_m("--alarm-below", below)
    require_clearance(method)
    return AlarmRules(below_m) if confidence is None else AlarmRules(below_m, confidence)
