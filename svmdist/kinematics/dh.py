"""Denavit–Hartenberg chains: rows of parameters to transforms, for one joint vector or many.

Both conventions are here because logs use both: *standard* (Denavit & Hartenberg 1955; Spong,
"Robot Modeling and Control", sec. 3.2), which the paper's eqs. (29) and (30) fit, and *modified*
(Craig, "Introduction to Robotics", sec. 3.4), in which the da Vinci Research Kit publishes its arms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.errors import KinematicsError
from svmdist.profile import Robot
from svmdist.transforms import Array

JointType = Literal["revolute", "prismatic", "fixed"]
Convention = Literal["standard", "modified"]


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row of a DH table: lengths in m, angles in rad, limits in the joint's own unit.

    The joint variable adds to `theta_rad` (revolute) or to `d_m` (prismatic), so that the value in a published
    table is the offset at joint value zero.
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


def twist(row: DHRow) -> tuple[float, float]:
    """Cosine and sine of the row's α; that of a quarter turn is exact, where floating point gives 6e-17."""
    cosine, sine = float(np.cos(row.alpha_rad)), float(np.sin(row.alpha_rad))
    return _snap(cosine), _snap(sine)


def _snap(value: float) -> float:
    nearest = float(np.round(value))
    return nearest if abs(value - nearest) < 1e-15 else value


CHUNK = 2048
"""Joint vectors that are worked on together, so that their columns stay in the processor's second-level cache."""
X, Y, Z, ORIGIN = np.vstack([np.eye(3), np.zeros(3)])[:, :, None]
"""Of the base frame, shape (3, 1) each."""


@dataclass(frozen=True, slots=True)
class FrameColumns:
    """Many frames in the base frame, by columns: axes x, y, z and origin p, shape (3, n), or (3, 1) where all agree."""

    x: Array
    y: Array
    z: Array
    p: Array

    def write(self, T: Array) -> None:
        """Into transforms, shape (n, 4, 4), whose last rows are filled already."""
        for column, values in enumerate((self.x, self.y, self.z, self.p)):
            T[:, :3, column] = values.T

    def twisted(self, row: DHRow) -> FrameColumns:
        """Behind Trans_x(a) Rot_x(α) of a row."""
        p = self.p if row.a_m == 0.0 else self.p + row.a_m * self.x
        cosine, sine = twist(row)
        if sine == 0.0 and cosine == 1.0:
            return FrameColumns(self.x, self.y, self.z, p)
        if cosine == 0.0:
            return FrameColumns(self.x, sine * self.z, -sine * self.y, p)
        return FrameColumns(self.x, cosine * self.y + sine * self.z, cosine * self.z - sine * self.y, p)

    def turned(self, row: DHRow, value: Array | float) -> FrameColumns:
        """Behind Rot_z(θ) Trans_z(d) of a row at joint values, shape (n,)."""
        x, y, p = self.x, self.y, self.p
        theta = row.theta_rad + value if row.joint == "revolute" else row.theta_rad
        d = row.d_m + value if row.joint == "prismatic" else row.d_m
        if row.joint == "prismatic" or row.d_m != 0.0:
            p = p + d * self.z
        if row.joint == "revolute" or row.theta_rad != 0.0:
            c, s = np.cos(theta), np.sin(theta)
            x, y = c * x + s * y, c * y - s * x
        return FrameColumns(x, y, self.z, p)


def last_frame(rows: tuple[DHRow, ...], convention: Convention, q: Array) -> FrameColumns:
    """The frame of the last row for joints of shape (n, n_joints)."""
    frame = FrameColumns(X, Y, Z, ORIGIN)
    joints = iter(np.ascontiguousarray(q.T))
    for row in rows:
        value = 0.0 if row.joint == "fixed" else next(joints)
        if convention == "standard":
            frame = frame.turned(row, value).twisted(row)
        else:
            frame = frame.twisted(row).turned(row, value)
    return frame


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


def pose_jacobian(chain: DHChain, q: ArrayLike, row: str | None = None) -> Array:
    """Derivative of a frame's pose in the base frame by the joints, shape (..., 6, n_joints), at `q` (..., n_joints).

    Rows are (δp, δθ): the origin's displacement in m, and the rotation vector in rad with
    R' = exp([δθ]) R, both in the base frame, per joint unit. The frame is that of the DH row `row`, or the
    tool. A revolute joint contributes (z x (p - p_joint), z), a prismatic one (z, 0), a joint behind the
    frame nothing (Siciliano et al., "Robotics", sec. 3.1.3).
    """
    return jacobian_of_frames(chain, frame_transforms(chain, q), row)


def jacobian_of_frames(chain: DHChain, frames: Array, row: str | None = None) -> Array:
    """The same from the poses of all row frames, shape (..., n_rows, 4, 4)."""
    last = len(chain.rows) - 1 if row is None else row_index(chain, row)
    T_base_frame = frames[..., last, :, :] @ chain.T_last_tool if row is None else frames[..., last, :, :]
    moving = [index for index, joint in enumerate(chain.rows) if joint.joint != "fixed"]
    axes = [joint_axis(chain, frames, index) for index in moving]
    shape = (*frames.shape[:-3], 3)
    z = np.stack([np.broadcast_to(axis, shape) for axis, _ in axes], -1)
    arm = T_base_frame[..., :3, 3, None] - np.stack([np.broadcast_to(at, shape) for _, at in axes], -1)
    revolute = np.array([chain.rows[index].joint == "revolute" for index in moving])
    before = np.array([index <= last for index in moving])
    zx, zy, zz = z[..., 0, :], z[..., 1, :], z[..., 2, :]
    x, y, h = arm[..., 0, :], arm[..., 1, :], arm[..., 2, :]
    swing = np.stack([zy * h - zz * y, zz * x - zx * h, zx * y - zy * x], -2)
    return np.concatenate([np.where(revolute, swing, z) * before, z * (revolute & before)], -2)


def joint_axis(chain: DHChain, frames: Array, index: int) -> tuple[Array, Array]:
    """The axis that the joint of row `index` moves about or along: direction and a point, shapes (..., 3).

    `frames`, shape (..., n_rows, 4, 4), are the poses of all row frames. Standard DH moves about the z of
    the frame before, modified DH about the z of its own frame.
    """
    axis_index = index - 1 if chain.convention == "standard" else index
    if axis_index < 0:
        return np.array([0.0, 0.0, 1.0]), np.zeros(3)
    return frames[..., axis_index, :3, 2], frames[..., axis_index, :3, 3]


def row_index(chain: DHChain, name: str) -> int:
    """Place of a row in the table; raises ValueError for a name it lacks."""
    if name not in chain.row_indices:
        raise ValueError(f"the chain has no row {name}; it has {', '.join(chain.row_indices)}")
    return chain.row_indices[name]


@dataclass(frozen=True, slots=True)
class ShaftAxis:
    """The instrument's shaft on the chain: a point in m and the direction to the tip, (3,), in the row's frame."""

    link: str
    p_axis_m: Array
    axis: Array


def shaft_of(chain: DHChain) -> ShaftAxis | None:
    """The shaft of a chain; None for a chain in which nothing slides."""
    prismatic = [row for row in chain.rows if row.joint == "prismatic"]
    if not prismatic:
        return None
    row = prismatic[-1]
    if chain.convention == "modified":
        return ShaftAxis(row.name, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The row's frame is Trans_x(a) Rot_x(α) away from the axis.
    axis = np.array([0.0, np.sin(row.alpha_rad), np.cos(row.alpha_rad)])
    return ShaftAxis(row.name, np.array([-row.a_m, 0.0, 0.0]), axis)


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


def chain_of(robot: Robot) -> DHChain:
    """Build the chain from base to tool; the profile has been checked when it was read."""
    rows = tuple(
        DHRow(
            joint.name,
            joint.type,
            joint.a_m,
            joint.alpha_rad,
            joint.d_m,
            joint.theta_rad,
            joint.lower,
            joint.upper,
            joint.aliases,
        )
        for joint in robot.joints
    )
    tolerance = (robot.limit_tolerance_rad, robot.limit_tolerance_m)
    return DHChain(rows, robot.convention, robot.T_last_tool, *tolerance)
