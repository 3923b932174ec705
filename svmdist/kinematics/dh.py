"""Denavit–Hartenberg chains: rows of parameters to transforms, for one joint vector or many.

Both conventions are here because logs use both: *standard* (Denavit & Hartenberg 1955; Spong,
"Robot Modeling and Control", sec. 3.2), which the paper's eqs. (29) and (30) fit, and *modified*
(Craig, "Introduction to Robotics", sec. 3.4), in which the da Vinci Research Kit publishes its arms.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from svmdist.errors import KinematicsError
from svmdist.transforms import Array

JointType = Literal["revolute", "prismatic", "fixed"]
Convention = Literal["standard", "modified"]


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row of a DH table: lengths in m, angles in rad, limits in the joint's own unit.

    The joint variable adds to `theta_rad` (revolute) or to `d_m` (prismatic), so that the value printed
    in a table is the offset at joint value zero.
    """

    name: str
    joint: JointType
    a_m: float = 0.0
    alpha_rad: float = 0.0
    d_m: float = 0.0
    theta_rad: float = 0.0
    lower: float = -np.pi
    upper: float = np.pi
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True)
class DHChain:
    """A serial chain from a base frame to a tool frame, with a constant transform behind the last row."""

    rows: tuple[DHRow, ...]
    convention: Convention = "standard"
    T_last_tool: Array = field(default_factory=lambda: np.eye(4))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints that move, base first."""
        return tuple(row.name for row in self.rows if row.joint != "fixed")

    @property
    def lower(self) -> Array:
        """Lower joint limits in rad or m, shape (n_joints,)."""
        return np.array([row.lower for row in self.rows if row.joint != "fixed"])

    @property
    def upper(self) -> Array:
        """Upper joint limits in rad or m, shape (n_joints,)."""
        return np.array([row.upper for row in self.rows if row.joint != "fixed"])


def link_transforms(chain: DHChain, q: ArrayLike) -> Array:
    """Transforms of each row from its predecessor, shape (..., n_rows, 4, 4), for joints (..., n_joints).

    Standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d).
    """
    q = _checked_joints(chain, q)
    theta, d = _joint_variables(chain, q)
    a = np.array([row.a_m for row in chain.rows])
    alpha = np.array([row.alpha_rad for row in chain.rows])
    # cos(π/2) is 6e-17 in floating point; a twist of a quarter turn is meant exactly.
    ca, sa = _snap(np.cos(alpha)), _snap(np.sin(alpha))
    ct, st = np.cos(theta), np.sin(theta)
    T = np.zeros((*theta.shape, 4, 4))
    T[..., 3, 3] = 1.0
    if chain.convention == "standard":
        T[..., 0, 0], T[..., 0, 1], T[..., 0, 2], T[..., 0, 3] = ct, -st * ca, st * sa, a * ct
        T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = st, ct * ca, -ct * sa, a * st
        T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = sa, ca, d
    else:
        T[..., 0, 0], T[..., 0, 1], T[..., 0, 3] = ct, -st, a
        T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = st * ca, ct * ca, -sa, -d * sa
        T[..., 2, 0], T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = st * sa, ct * sa, ca, d * ca
    return T


def forward_kinematics(chain: DHChain, q: ArrayLike) -> Array:
    """Pose of the tool in the base frame, `T_base_tool`, shape (..., 4, 4), for joints (..., n_joints).

    eq. (31), as a matrix product. Raises KinematicsError for a wrong number of joints.
    """
    links = link_transforms(chain, q)
    T = links[..., 0, :, :]
    for index in range(1, len(chain.rows)):
        T = T @ links[..., index, :, :]
    return np.asarray(T @ chain.T_last_tool)


def frame_transforms(chain: DHChain, q: ArrayLike) -> Array:
    """Poses of all row frames in the base frame, shape (..., n_rows, 4, 4), for joints (..., n_joints)."""
    links = link_transforms(chain, q)
    frames = np.empty_like(links)
    frames[..., 0, :, :] = links[..., 0, :, :]
    for index in range(1, len(chain.rows)):
        frames[..., index, :, :] = frames[..., index - 1, :, :] @ links[..., index, :, :]
    return frames


def select_joints(chain: DHChain, names: tuple[str, ...], positions: ArrayLike) -> Array:
    """Bring positions, shape (..., len(names)), into the chain's order; joints it lacks are dropped.

    A joint is found by its name or by an alias. Raises KinematicsError that names the joints the log does
    not have.
    """
    order, missing = [], []
    for row in chain.rows:
        if row.joint == "fixed":
            continue
        found = next((name for name in (row.name, *row.aliases) if name in names), None)
        if found is None:
            missing.append(row.name)
        else:
            order.append(names.index(found))
    if missing:
        raise KinematicsError(
            f"the chain needs the joints {', '.join(missing)}; the log has {', '.join(names) or 'none'}"
        )
    return np.asarray(positions, np.float64)[..., order]


def _checked_joints(chain: DHChain, q: ArrayLike) -> Array:
    q = np.asarray(q, np.float64)
    count = len(chain.joint_names)
    if q.ndim == 0 or q.shape[-1] != count:
        raise KinematicsError(f"expected {count} joint values on the last axis, found shape {q.shape}")
    return q


def _joint_variables(chain: DHChain, q: Array) -> tuple[Array, Array]:
    """θ and d of every row, both of shape (..., n_rows)."""
    shape = (*q.shape[:-1], len(chain.rows))
    theta = np.broadcast_to([row.theta_rad for row in chain.rows], shape).copy()
    d = np.broadcast_to([row.d_m for row in chain.rows], shape).copy()
    column = 0
    for index, row in enumerate(chain.rows):
        if row.joint == "revolute":
            theta[..., index] += q[..., column]
        elif row.joint == "prismatic":
            d[..., index] += q[..., column]
        column += row.joint != "fixed"
    return theta, d


def _snap(values: Array) -> Array:
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < 1e-15, nearest, values)
