"""Bodies of the world in MuJoCo: moved from outside, pushed back by nothing, in contact with the robot's bodies."""

from collections.abc import Sequence

import mujoco
import numpy as np

from robots.messages import Array
from robots.mujoco_spec import COLLISION_GROUP
from sims.shapes import Shape

CONTACT_BIT = 4
"""Bit of the contacts between the world's bodies and the robot's collision bodies: those touch nothing else."""

TYPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
"""By the kinds of :class:`sims.shapes.Shape`, whose sizes are MuJoCo's."""


def add_bodies(spec: mujoco.MjSpec, bodies: Sequence[Shape]) -> None:
    """Add bodies to a robot's model, where they are; the robot's collision bodies get in contact with them.

    Soles are left out, so that what they bear stays the ground's; the feet's collision bodies are not.
    """
    if not bodies:
        return
    for geom in spec.geoms:
        if geom.group == COLLISION_GROUP:
            geom.conaffinity |= CONTACT_BIT
    for i, body in enumerate(bodies):
        handle = spec.worldbody.add_body()
        handle.name, handle.mocap = f"world_{i}", True
        handle.pos, handle.quat = body.center, quaternion(body)
        geom = handle.add_geom()
        geom.type, geom.size = TYPES[body.kind], [*body.size, 0.0, 0.0][:3]
        geom.contype, geom.conaffinity = CONTACT_BIT, 0
        # as stiff as the soles on the ground
        geom.solref = [0.005, 1.0]
        geom.rgba = [0.6, 0.6, 0.62, 1.0]


def quaternion(body: Shape) -> Array:
    """Orientation (4,) of a body as MuJoCo has it: w, x, y, z."""
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(body.rotation, dtype=float).ravel())
    return out
