"""Which rows of a chain are an instrument's wrist, whatever the convention and whether or not it has a jaw."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.kinematics.dh import DHChain


@dataclass(frozen=True, slots=True)
class WristRows:
    """Indices of the rows that turn the shaft about itself and bend the wrist; `jaw` is None without one."""

    roll: int
    pitch: int
    yaw: int
    jaw: int | None


def wrist_rows(chain: DHChain) -> WristRows | None:
    """The revolute rows behind the last one that slides: roll, wrist pitch, wrist yaw, and a jaw where it is there.

    That is the wrist of the da Vinci's instruments. None for a chain that slides nowhere, or has fewer behind it.
    """
    turns = rows_behind_insertion(chain)
    if len(turns) < 3:
        return None
    roll, pitch, yaw = turns[:3]
    return WristRows(roll, pitch, yaw, turns[3] if len(turns) > 3 else None)


def rows_behind_insertion(chain: DHChain) -> list[int]:
    """Indices of the revolute rows behind the last one that slides, the shaft's roll first; none if none slides."""
    slides = [index for index, row in enumerate(chain.rows) if row.joint == "prismatic"]
    if not slides:
        return []
    return [index for index, row in enumerate(chain.rows) if row.joint == "revolute" and index > slides[-1]]
