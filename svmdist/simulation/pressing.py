"""Where instruments press on tissue that gives way: its shape at a moment, and the clearances to that shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.clearance.bounds import HalfSpaces
from svmdist.simulation.clearance.relief_meter import PartSamples, ReliefMeter, seen_from_tissue
from svmdist.simulation.plan import Moment
from svmdist.simulation.room.dent import Dent, YieldingOrgan
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, inverse


class Pressing:
    """The tissue of a scene under the instruments of all arms, by scene and samples of each."""

    def __init__(self, arms: Sequence[tuple[Scene, PartSamples]]) -> None:
        self._arms = tuple(arms)
        scene = arms[0][0]
        self._scene = scene
        self._organ = YieldingOrgan(scene.organ)
        self._half_spaces = HalfSpaces.about(scene.organ.mesh.vertices_m)
        self._T_tissue_world = inverse(scene.T_world_tissue)

    def tissue(self, moment: Moment) -> DrawnMesh | None:
        """The organ's mesh at a moment, in the tissue frame; None where nothing presses."""
        points_m = self._inside_m(moment.q, moment.rise_m)
        return self._organ.dented(points_m).mesh if len(points_m) else None

    def clearances_m(
        self, at_rest_m: Sequence[Array], q: Sequence[Array], rise_m: Array | None
    ) -> list[Array]:
        """Clearances of each arm, shape (n,), to tissue that gives way, by those to tissue at rest, shape (n,).

        Joints have shape (n, n_joints), the rise of the tissue shape (n,). Away from the tissue nothing changes, and
        what presses touches: 0, where the tissue gives way as far as that. An arm that does not press is
        measured to what the others leave.
        """
        found = [np.maximum(clearance_m, 0.0) for clearance_m in at_rest_m]
        for at in np.nonzero(np.min(at_rest_m, axis=0) < 0.0)[0].tolist():
            rise = 0.0 if rise_m is None else float(rise_m[at])
            points_m = self._inside_m([its[at] for its in q], rise)
            if not len(points_m):
                continue
            too_deep = self._organ.is_too_deep(points_m)
            measured = [arm for arm, rest_m in enumerate(at_rest_m) if too_deep or rest_m[at] > 0.0]
            if not measured:
                continue
            dent = self._organ.dented(points_m)
            for arm in measured:
                found[arm][at] = self._measured_m(arm, dent, q[arm][at], rise)
        return found

    def _measured_m(self, arm: int, dent: Dent, q: Array, rise_m: float) -> float:
        scene, samples = self._arms[arm]
        meter = ReliefMeter(scene, samples, dent.mesh)
        return float(meter.clearances_m(q[None], np.array([rise_m]))[0])

    def _inside_m(self, q: Sequence[Array], rise_m: float) -> Array:
        """Samples of all instruments that would be inside the organ at rest, in the tissue frame, shape (n, 3)."""
        found = [np.zeros((0, 3))]
        for (scene, samples), its in zip(self._arms, q, strict=True):
            poses = seen_from_tissue(scene, its[None], np.array([rise_m]))
            T_tissue_part = self._T_tissue_world @ samples.bounds.stacked(poses)
            low = samples.bounds.least_m(T_tissue_part, self._half_spaces)[0] <= 0.0
            for part in np.nonzero(low)[0].tolist():
                points_m = samples.below_m(part, T_tissue_part[0, part], self._organ.height_m)
                found.append(points_m[self._organ.inside_m(points_m) > 0.0])
        return np.vstack(found)
