"""What an arm reports of its joints over a whole recording: nominal joints, late and perturbed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.perturbations.chosen import Perturbations
from svmdist.perturbations.clock import reported_late
from svmdist.perturbations.joints import JointPerturber, JointUnits
from svmdist.perturbations.perturbation import Place
from svmdist.profile import Profile
from svmdist.transforms import Array


def reported_joints(
    q: Array,
    stamps_ns: NDArray[np.int64],
    is_sample: NDArray[np.bool_],
    profile: Profile,
    perturbations: Perturbations,
    seed: int,
    arm: int,
) -> Array:
    """What is reported of joints `q`, shape (n, n_joints), at stamps (n,), of which `is_sample` (n,) are the encoders'.

    Between samples, where only transforms are written, lies a straight line. Without perturbations it is `q` itself.
    """
    if not (perturbations.changes(Place.JOINTS) or perturbations.changes(Place.CLOCK)):
        return q
    at_ns = stamps_ns[is_sample]
    late = reported_late(q[is_sample], at_ns, perturbations)
    perturber = JointPerturber(JointUnits.of(profile), perturbations, seed, arm)
    samples = np.array(
        [perturber.perturbed(row, stamp) for row, stamp in zip(late, at_ns.tolist(), strict=True)]
    )
    seconds, at_s = 1e-9 * (stamps_ns - at_ns[0]), 1e-9 * (at_ns - at_ns[0])
    return np.column_stack([np.interp(seconds, at_s, joint) for joint in samples.T])
