"""How far things move in the image while a frame is exposed."""

from __future__ import annotations

import numpy as np

from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.plan import Moment, Plan
from svmdist.simulation.scene import risen
from svmdist.transforms import Array, inverse, transform_points

VERTEX_STEP = 16
"""Each so many-th vertex of a mesh tells how far it moves."""


def motion_px(plan: Plan, index: int) -> float:
    """The largest way of a point in the image while a rolling shutter goes over the frame of stamp number `index`.

    Points are vertices of the instruments' parts and of the organ, and the retractor's tip.
    """
    half_ns = 0.5e6 * plan.scene.room.rolling
    if not half_ns:
        return 0.0
    places = [_pixels(plan, plan.moment(index, after_ns)) for after_ns in (-half_ns, 0.0, half_ns)]
    steps = np.linalg.norm(np.diff(np.stack(places), axis=0), axis=-1)
    width, height = plan.scene.camera.width_px, plan.scene.camera.height_px
    seen = np.all((places[1] >= 0.0) & (places[1] < [width, height]), axis=1)
    return float(steps.sum(axis=0)[seen].max(initial=0.0))


def _pixels(plan: Plan, moment: Moment) -> Array:
    """Where the points of a moment are in the left image, shape (n, 2)."""
    scene = plan.scene
    points = [transform_points(risen(moment.rise_m) @ scene.T_world_tissue, _some(scene.organ.mesh))]
    for arm, q in zip(plan.arms, moment.q, strict=True):
        poses = arm.scene.link_poses(q)
        points += [transform_points(poses[part.link], _some(part.mesh)) for part in arm.scene.parts]
    if moment.T_world_retractor is not None:
        points.append(moment.T_world_retractor[None, :3, 3])
    p_camera_m = transform_points(inverse(scene.T_world_camera), np.vstack(points))
    return scene.camera.project(p_camera_m)


def _some(mesh: DrawnMesh) -> Array:
    return mesh.vertices_m[::VERTEX_STEP]
