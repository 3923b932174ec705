"""Denavit–Hartenberg chains: rows of parameters to transforms, for one joint vector or many.

Both conventions are here because logs use both: *standard* (Denavit & Hartenberg 1955; Spong,
"Robot Modeling and Control", sec. 3.2), which the paper's eqs. (29) and (30) fit, and *modified*
(Craig, "Introduction to Robotics", sec. 3.4), in which the da Vinci Research Kit publishes its arms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.errors import KinematicsError
from svmdist.kinematics.dh_row import Convention, DHRow, JointType, twist
from svmdist.kinematics.frame_columns import CHUNK, last_frame
from svmdist.transforms import Array

__all__ = [
    "Convention",
    "DHChain",
    "DHRow",
    "JointType",
    "forward_kinematics",
    "frame_transforms",
    "link_transforms",
    "running_product",
    "select_joints",
]
MANY = 128
"""From so many joint vectors on, arrays of one number of all of them are faster than stacks of matrices."""


@dataclass(frozen=True, eq=False)
class DHChain:
    """A serial chain from a base frame to a tool frame, with a constant transform behind the last row."""

    rows: tuple[DHRow, ...]
    convention: Convention = "standard"
    T_last_tool: Array = field(default_factory=lambda: np.eye(4))
    limit_tolerance_rad: float = np.inf
    """How far beyond its limits a joint that turns may be reported."""
    limit_tolerance_m: float = np.inf
    """The same of a joint that slides."""

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints that move, base first."""
        return tuple(row.name for row in self.rows if row.joint != "fixed")

    @cached_property
    def lower(self) -> Array:
        """Lower joint limits in rad or m, shape (n_joints,)."""
        return _constant([row.lower for row in self.rows if row.joint != "fixed"])

    @cached_property
    def upper(self) -> Array:
        """Upper joint limits in rad or m, shape (n_joints,)."""
        return _constant([row.upper for row in self.rows if row.joint != "fixed"])

    @cached_property
    def limit_tolerance(self) -> Array:
        """How far beyond its limits each joint may be reported, in rad or m, shape (n_joints,)."""
        return np.where(self.is_revolute, self.limit_tolerance_rad, self.limit_tolerance_m)

    def are_within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Which joints, shape (..., n_joints), are within their limits and the tolerance."""
        tolerance = self.limit_tolerance
        return np.asarray((q >= self.lower - tolerance) & (q <= self.upper + tolerance))

    @cached_property
    def moving_rows(self) -> NDArray[np.intp]:
        """Indices of the rows with a joint, base first, shape (n_joints,)."""
        return np.array([i for i, row in enumerate(self.rows) if row.joint != "fixed"], np.intp)

    @cached_property
    def is_revolute(self) -> NDArray[np.bool_]:
        """Which joints turn, shape (n_joints,); the others slide."""
        return np.array([row.joint == "revolute" for row in self.rows if row.joint != "fixed"], np.bool_)

    @cached_property
    def row_indices(self) -> dict[str, int]:
        """The place of each row in the table by its name."""
        return {row.name: index for index, row in reversed(list(enumerate(self.rows)))}

    @cached_property
    def terms(self) -> LinkTerms:
        """What is constant in the rows' transforms."""
        return LinkTerms.of(self.rows, self.convention)


@dataclass(frozen=True, slots=True)
class LinkTerms:
    """The transforms of all rows as sums: `constant` + cos θ `cosine` + sin θ `sine` + d `shift`, (n_rows, 4, 4) each.

    θ and d, shape (n_rows,), are those at joint value zero. `into_theta` and `into_d`, shape (n_joints, n_rows), add
    the joints to them.
    """

    constant: Array
    cosine: Array
    sine: Array
    shift: Array
    theta_rad: Array
    d_m: Array
    into_theta: Array
    into_d: Array

    @classmethod
    def of(cls, rows: tuple[DHRow, ...], convention: Convention) -> LinkTerms:
        """Take the rows apart."""
        a = np.array([row.a_m for row in rows])
        ca, sa = np.array([twist(row) for row in rows]).reshape(-1, 2).T
        constant, cosine, sine, shift = np.zeros((4, len(rows), 4, 4))
        constant[:, 3, 3] = 1.0
        if convention == "standard":
            cosine[:, 0, 0], cosine[:, 0, 3], cosine[:, 1, 1], cosine[:, 1, 2] = 1.0, a, ca, -sa
            sine[:, 0, 1], sine[:, 0, 2], sine[:, 1, 0], sine[:, 1, 3] = -ca, sa, 1.0, a
            constant[:, 2, 1], constant[:, 2, 2] = sa, ca
            shift[:, 2, 3] = 1.0
        else:
            cosine[:, 0, 0], cosine[:, 1, 1], cosine[:, 2, 1] = 1.0, ca, sa
            sine[:, 0, 1], sine[:, 1, 0], sine[:, 2, 0] = -1.0, ca, sa
            constant[:, 0, 3], constant[:, 1, 2], constant[:, 2, 2] = a, -sa, ca
            shift[:, 1, 3], shift[:, 2, 3] = -sa, ca
        into_theta, into_d = (
            np.array([row.joint == joint for row in rows], np.float64)
            * np.eye(len(rows))[[i for i, row in enumerate(rows) if row.joint != "fixed"]]
            for joint in ("revolute", "prismatic")
        )
        theta, d = np.array([row.theta_rad for row in rows]), np.array([row.d_m for row in rows])
        return cls(constant, cosine, sine, shift, theta, d, into_theta, into_d)


def link_transforms(chain: DHChain, q: ArrayLike, first: int = 0) -> Array:
    """Transforms of the rows from `first` on from their predecessors, shape (..., n_rows - first, 4, 4).

    The joints, shape (..., n_joints), are those of the whole chain. Standard: Rot_z(θ) Trans_z(d) Trans_x(a)
    Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d). Raises KinematicsError for a wrong number of joints.
    """
    q = _checked_joints(chain, q)
    terms = chain.terms
    theta = (terms.theta_rad[first:] + q @ terms.into_theta[:, first:])[..., None, None]
    d = (terms.d_m[first:] + q @ terms.into_d[:, first:])[..., None, None]
    T = np.cos(theta) * terms.cosine[first:]
    T += np.sin(theta) * terms.sine[first:]
    T += d * terms.shift[first:]
    T += terms.constant[first:]
    return np.asarray(T)


def forward_kinematics(chain: DHChain, q: ArrayLike) -> Array:
    """Pose of the tool in the base frame, `T_base_tool`, shape (..., 4, 4), for joints (..., n_joints).

    eq. (31), as a matrix product. Raises KinematicsError for a wrong number of joints.
    """
    q = _checked_joints(chain, q)
    if math.prod(q.shape[:-1]) < MANY:
        links = link_transforms(chain, q)
        T = links[..., 0, :, :]
        for index in range(1, len(chain.rows)):
            T = T @ links[..., index, :, :]
        return np.asarray(T @ chain.T_last_tool)
    T = np.empty((*q.shape[:-1], 4, 4))
    T[..., 3, :] = 0.0, 0.0, 0.0, 1.0
    flat, joints = T.reshape(-1, 4, 4), q.reshape(-1, q.shape[-1])
    for at in range(0, len(joints), CHUNK):
        last_frame(chain.rows, chain.convention, joints[at : at + CHUNK]).write(flat[at : at + CHUNK])
    return np.asarray((T.reshape(-1, 4) @ chain.T_last_tool).reshape(T.shape))


def frame_transforms(chain: DHChain, q: ArrayLike) -> Array:
    """Poses of all row frames in the base frame, shape (..., n_rows, 4, 4), for joints (..., n_joints).

    Always products of matrices: recordings are made with them, and repeat bit for bit.
    """
    return running_product(link_transforms(chain, q))


def running_product(links: Array) -> Array:
    """Products of the first, the first two, … transforms, shape (..., n, 4, 4): frames by their links; in place."""
    if links.ndim == 3:
        for index in range(1, len(links)):
            links[index] = links[index - 1].dot(links[index])
        return links
    for index in range(1, links.shape[-3]):
        links[..., index, :, :] = links[..., index - 1, :, :] @ links[..., index, :, :]
    return links


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


def _constant(values: list[float]) -> Array:
    array = np.array(values)
    array.setflags(write=False)
    return array


def _checked_joints(chain: DHChain, q: ArrayLike) -> Array:
    q = np.asarray(q, np.float64)
    count = len(chain.joint_names)
    if q.ndim == 0 or q.shape[-1] != count:
        raise KinematicsError(f"expected {count} joint values on the last axis, found shape {q.shape}")
    return q
