"""Denavit–Hartenberg chains: rows of parameters to transforms, for one joint vector or many.

Logs use both conventions: *standard* (Denavit & Hartenberg 1955; Spong, "Robot Modeling and Control", sec. 3.2), which
the paper's eqs. (29) and (30) fit, and *modified* (Craig, "Introduction to Robotics", sec. 3.4), as of the dVRK.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.errors import KinematicsError
from svmdist.profile.robot import Joint, Robot
from svmdist.transforms import Array, make_transform

CHUNK = 2048  # joint vectors that are worked on together: more links at once leave the processor's cache
CLOSE_M, MAX_STEPS, DAMPING_M = 1e-9, 60, 1e-4
"""Of inverse kinematics; damping far below a robot's lever arms slows convergence near singularities only."""


class DHChain:
    """A serial chain from base to tool, the last transform constant; tolerances are beyond joints' limits.

    Of the joints that move, base first, it has `moving_joints`, their names and arrays, shape (n_joints,): indices of
    their rows, which are revolute (the others are prismatic), limits and the limits' tolerance in rad or m.
    """

    def __init__(
        self,
        rows: tuple[Joint, ...],
        convention: Literal["standard", "modified"] = "standard",
        T_last_tool: Array | None = None,
        limit_tolerance_rad: float = np.inf,
        limit_tolerance_m: float = np.inf,
    ) -> None:
        self.rows, self.convention = rows, convention
        self.T_last_tool = np.eye(4) if T_last_tool is None else T_last_tool
        self.moving_rows = np.array([index for index, row in enumerate(rows) if row.type != "fixed"], np.intp)
        self.moving_joints = [rows[index] for index in self.moving_rows]
        self.joint_names = tuple(joint.name for joint in self.moving_joints)
        self.lower = np.array([joint.lower for joint in self.moving_joints])
        self.upper = np.array([joint.upper for joint in self.moving_joints])
        self.is_revolute = np.array([joint.type == "revolute" for joint in self.moving_joints], np.bool_)
        self.limit_tolerance = np.where(self.is_revolute, limit_tolerance_rad, limit_tolerance_m)

    def are_within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Which joints, shape (..., n_joints), are within their limits and the tolerance."""
        return np.asarray((q >= self.lower - self.limit_tolerance) & (q <= self.upper + self.limit_tolerance))

    @cached_property
    def terms(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Trans_x(a) Rot_x(α) of all rows, (n_rows, 4, 4); θ and d at joint value 0, and which rows turn, (n_rows,)."""
        a, alpha, d, theta = np.array([(row.a_m, row.alpha_rad, row.d_m, row.theta_rad) for row in self.rows]).T
        # Quarter turns are exact, where floating point gives 6e-17.
        turns = np.array([np.cos(alpha), np.sin(alpha)])
        c, s = np.where(np.abs(turns - np.round(turns)) < 1e-15, np.round(turns), turns)
        return _screws(0, c, s, a), theta, d, np.array([row.type == "revolute" for row in self.rows])


def chain_of(robot: Robot) -> DHChain:
    """The chain of a profile's robot, from base to tool."""
    T_last_tool = None if robot.tool_rotation is None else make_transform(robot.tool_rotation, np.zeros(3))
    tolerances = robot.limit_tolerance_rad, robot.limit_tolerance_m
    return DHChain(robot.joints, robot.convention, T_last_tool, *tolerances)


def link_transforms(chain: DHChain, q: ArrayLike) -> Array:
    """Transforms of the rows from their predecessors, shape (..., n_rows, 4, 4), for joints (..., n_joints).

    Standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d). Raises
    KinematicsError for a wrong number of joints.
    """
    q = np.asarray(q, np.float64)
    count = len(chain.joint_names)
    if q.ndim == 0 or q.shape[-1] != count:
        raise KinematicsError(f"expected {count} joint values on the last axis, found shape {q.shape}")
    about_x, theta_rad, d_m, turns = chain.terms
    joint = np.zeros((*q.shape[:-1], len(chain.rows)))
    joint[..., chain.moving_rows] = q
    theta_rad, d_m = theta_rad + turns * joint, d_m + ~turns * joint
    about_z = _screws(2, np.cos(theta_rad), np.sin(theta_rad), d_m)
    return np.asarray(about_z @ about_x if chain.convention == "standard" else about_x @ about_z)


def _screws(axis: int, cosine: Array, sine: Array, shift_m: Array) -> Array:
    """Rotations about one of the axes 0 to 2, and shifts along it, all of shape (...): transforms (..., 4, 4)."""
    T, i, j = np.zeros((*cosine.shape, 4, 4)), (axis + 1) % 3, (axis + 2) % 3
    T[..., i, i] = T[..., j, j] = cosine
    T[..., j, i], T[..., i, j], T[..., axis, 3] = sine, -sine, shift_m
    T[..., axis, axis] = T[..., 3, 3] = 1.0
    return T


def forward_kinematics(chain: DHChain, q: ArrayLike) -> Array:
    """`T_base_tool`, shape (..., 4, 4), for joints (..., n_joints): eq. (31). KinematicsError for another number."""
    q = np.asarray(q, np.float64)
    if q.ndim > 1 and len(q) > CHUNK:
        return np.concatenate([forward_kinematics(chain, q[at : at + CHUNK]) for at in range(0, len(q), CHUNK)])
    return np.asarray(frame_transforms(chain, q)[..., -1, :, :] @ chain.T_last_tool)


def frame_transforms(chain: DHChain, q: ArrayLike) -> Array:
    """Poses of all row frames in the base frame, shape (..., n_rows, 4, 4), for joints (..., n_joints)."""
    return running_product(link_transforms(chain, q))


def running_product(links: Array) -> Array:
    """Products of the first, the first two, … transforms, shape (..., n, 4, 4): frames by their links; in place."""
    for index in range(1, links.shape[-3]):
        links[..., index, :, :] = links[..., index - 1, :, :] @ links[..., index, :, :]
    return links


def select_joints(chain: DHChain, names: tuple[str, ...], positions: ArrayLike) -> Array:
    """Positions, (..., len(names)), in the chain's order, by name or alias; KinematicsError names lacking ones."""
    known = [[name for name in (joint.name, *joint.aliases) if name in names] for joint in chain.moving_joints]
    if missing := [name for name, logged in zip(chain.joint_names, known, strict=True) if not logged]:
        there = ", ".join(names) or "none"
        raise KinematicsError(f"the chain needs the joints {', '.join(missing)}; the log has {there}")
    return np.asarray(positions, np.float64)[..., [names.index(logged[0]) for logged in known]]


def joint_axis(chain: DHChain, frames: Array, index: int) -> tuple[Array, Array]:
    """The axis that the joint of row `index` moves about or along: direction and a point, shapes (..., 3).

    `frames`, shape (..., n_rows, 4, 4), are the poses of all row frames.
    """
    # Standard DH moves about the z of the frame before, modified DH about the z of its own frame.
    axis_index = index - 1 if chain.convention == "standard" else index
    if axis_index < 0:
        return np.array([0.0, 0.0, 1.0]), np.zeros(3)
    return frames[..., axis_index, :3, 2], frames[..., axis_index, :3, 3]


def row_index(chain: DHChain, name: str) -> int:
    """Index of a row in the table; raises ValueError for a name that no row has."""
    return [row.name for row in chain.rows].index(name)


@dataclass(frozen=True, slots=True)
class ShaftAxis:
    """The instrument's shaft on the chain: a point in m and the direction to the tip, (3,), in the row's frame."""

    link: str
    p_axis_m: Array
    axis: Array


def shaft_of(chain: DHChain) -> ShaftAxis | None:
    """The shaft of a chain; None for a chain in which nothing slides."""
    row = next((row for row in reversed(chain.rows) if row.type == "prismatic"), None)
    if row is None:
        return None
    if chain.convention == "modified":
        return ShaftAxis(row.name, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The row's frame is Trans_x(a) Rot_x(α) away from the axis.
    axis = np.array([0.0, np.sin(row.alpha_rad), np.cos(row.alpha_rad)])
    return ShaftAxis(row.name, np.array([-row.a_m, 0.0, 0.0]), axis)


def rows_behind_insertion(chain: DHChain) -> list[int]:
    """Indices of the revolute rows behind the last prismatic one, the shaft's roll first; none without one."""
    slides = [index for index, row in enumerate(chain.rows) if row.type == "prismatic"]
    behind = range(slides[-1] + 1, len(chain.rows)) if slides else ()
    return [index for index in behind if chain.rows[index].type == "revolute"]


def solve_position(chain: DHChain, q_start: ArrayLike, p_base_tool_m: ArrayLike, free_joints: Sequence[str]) -> Array:
    """Find joints, shape (n, n_joints), that bring the tool's origin to targets in the base frame, (n, 3).

    By damped least squares, from `q_start`, shape (n, n_joints); joints that are not free stay. Raises KinematicsError
    for a target that is out of reach or needs a joint outside its limits.
    """
    q, targets_m = np.array(q_start, np.float64), np.asarray(p_base_tool_m, np.float64)
    free = [chain.joint_names.index(name) for name in free_joints]
    for _ in range(MAX_STEPS):
        frames = frame_transforms(chain, q)
        p_m = (frames[:, -1] @ chain.T_last_tool)[:, :3, 3]
        error_m = targets_m - p_m
        if float(np.max(np.abs(error_m), initial=0.0)) <= CLOSE_M:
            break
        columns = []  # Siciliano et al., "Robotics", sec. 3.1.3
        for joint in free:
            axis, at_m = joint_axis(chain, frames, chain.moving_rows[joint])
            axis = np.broadcast_to(axis, p_m.shape)
            columns.append(np.cross(axis, p_m - at_m) if chain.is_revolute[joint] else axis)
        J = np.moveaxis(np.array(columns), 0, -1)
        # dq = J^T (J J^T + λ² I)^-1 e (Nakamura & Hanafusa 1986)
        damped = J @ np.swapaxes(J, 1, 2) + DAMPING_M**2 * np.eye(3)
        q[:, free] += (np.swapaxes(J, 1, 2) @ np.linalg.solve(damped, error_m[:, :, None]))[..., 0]
    else:
        worst = int(np.argmax(np.linalg.norm(error_m, axis=1)))
        left_m = np.linalg.norm(error_m[worst])
        raise KinematicsError(f"position {worst} is out of reach: {left_m:.3g} m are left after {MAX_STEPS} steps")
    for row, joint in np.argwhere((q < chain.lower) | (q > chain.upper)):
        name, limits = chain.joint_names[joint], f"{chain.lower[joint]:.4g} to {chain.upper[joint]:.4g}"
        raise KinematicsError(f"joint {name} would have to go to {q[row, joint]:.4g}, outside its limits {limits}")
    return q
