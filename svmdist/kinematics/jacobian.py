"""Geometric Jacobians: how the pose of a frame on the chain answers to small changes of the joints.

They serve motion (inverse kinematics) and error alike: an offset of a joint moves the frames behind it as
a motion by that offset would.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.transforms import Array


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
