"""Other collision bodies for a robot: a description keeps everything else and takes its spheres from a second file."""

import dataclasses
from importlib import resources

from robots.description import RobotDescription
from robots.errors import DescriptionError, UnknownNameError
from robots.loader import read_collisions

COLLISION_MODELS = ("g1_spheres",)
"""Collision models that come with the project, each in a file of this name beside the descriptions."""


def with_collision_model(robot: RobotDescription, name: str) -> RobotDescription:
    """The robot with other collision bodies and self-collision pairs.

    Args:
        robot: a checked description; not changed.
        name: ``g1_spheres``, the 19 spheres and 29 pairs of the SPARK benchmark (version 1.0) on the G1.

    Returns:
        A checked description whose ``collisions`` and ``self_collision_pairs`` are those of the model, with its
        ``leg_pairs`` (none in ``g1_spheres``).

    Raises:
        UnknownNameError: no such model.
        DescriptionError: the robot lacks a body that the model puts a collision body on.
    """
    if name not in COLLISION_MODELS:
        raise UnknownNameError("collision model", name, list(COLLISION_MODELS))
    file = resources.files("robots") / "data" / f"{name}.toml"
    with resources.as_file(file) as path:
        shapes, pairs, leg_pairs = read_collisions(path)
    bodies = {b.name for b in robot.bodies}
    for shape in shapes:
        if shape.body not in bodies:
            entry, allowed = f"collision '{shape.name}': body", f"the name of a body of the robot '{robot.name}'"
            raise DescriptionError(f"{name}.toml", entry, shape.body, allowed)
    return dataclasses.replace(robot, collisions=shapes, self_collision_pairs=pairs, leg_pairs=leg_pairs)
