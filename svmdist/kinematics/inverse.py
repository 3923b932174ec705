"""Inverse kinematics of a DH chain: damped least squares on the tool's position, many targets at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from svmdist.errors import KinematicsError
from svmdist.kinematics.dh import DHChain, frame_transforms, jacobian_of_frames
from svmdist.transforms import Array


def solve_position(
    chain: DHChain,
    q_start: ArrayLike,
    p_base_tool_m: ArrayLike,
    free_joints: Sequence[str],
    *,
    tolerance_m: float = 1e-9,
    damping: float = 1e-4,
    max_iterations: int = 60,
) -> Array:
    """Find joints, shape (n, n_joints), that bring the tool's origin to targets in the base frame, (n, 3).

    `q_start`, shape (n, n_joints), has the first guess of the free joints and the values of all others, which stay.
    `damping` is in the unit of the Jacobian; 1e-4 m is far below the lever arms of a surgical robot: it slows
    convergence near singularities only. Raises KinematicsError for a target that is out of reach or needs a joint
    outside its limits.
    """
    q, targets_m = np.array(q_start, np.float64), np.asarray(p_base_tool_m, np.float64)
    free = [chain.joint_names.index(name) for name in free_joints]
    for _ in range(max_iterations):
        frames = frame_transforms(chain, q)
        error_m = targets_m - (frames[:, -1] @ chain.T_last_tool)[:, :3, 3]
        if float(np.max(np.abs(error_m), initial=0.0)) <= tolerance_m:
            break
        J = jacobian_of_frames(chain, frames)[:, :3, free]
        # dq = J^T (J J^T + λ² I)^-1 e (Nakamura & Hanafusa 1986)
        damped = J @ np.swapaxes(J, 1, 2) + damping**2 * np.eye(3)
        q[:, free] += (np.swapaxes(J, 1, 2) @ np.linalg.solve(damped, error_m[:, :, None]))[..., 0]
    else:
        worst = int(np.argmax(np.linalg.norm(error_m, axis=1)))
        raise KinematicsError(
            f"position {worst} is out of reach: {np.linalg.norm(error_m[worst]):.3g} m are left "
            f"after {max_iterations} steps"
        )
    for row, joint in np.argwhere((q < chain.lower) | (q > chain.upper)):
        raise KinematicsError(
            f"joint {chain.joint_names[joint]} would have to go to {q[row, joint]:.4g}, outside its limits "
            f"{chain.lower[joint]:.4g} to {chain.upper[joint]:.4g}"
        )
    return q
