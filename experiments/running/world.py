"""The bodies around a robot while it runs: what is there, what is seen of it, what is known of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from controllers.agent import Agent
from controllers.perception import Detection
from experiments.scenarios.pushes import Push
from experiments.scenarios.world import Sensor, WorldObject, require_unique_names
from robots.messages import Array
from safety.geometry.shapes import Obstacle
from sims.obstacles import PositionSensor
from sims.plant import MujocoPlant
from sims.shapes import Shape

if TYPE_CHECKING:
    from controllers.obstacle_tracker import TrackingSettings

SENSOR_STREAM = 1
"""Second entry of the seed of the sensors' noise; the plant's noise has the seed alone."""

PLATE, THICK = 20.0, 1.0
"""Half the width and half the thickness of a half-space in the simulator [m]."""


class World:
    """The bodies of a scenario as functions of time, and their sensors.

    Args:
        objects: in the order in which everything is listed.
        seed: of the sensors' noise: each body's sensor has a stream of its own.

    Attributes:
        objects: as given.

    Raises:
        ConfigError: two bodies have the same name.
    """

    def __init__(self, objects: Sequence[WorldObject], seed: int) -> None:
        self.objects = tuple(objects)
        require_unique_names(self.objects)
        self._motions = [o.motion.motion() for o in objects]
        self._sensors = [_sensor(o, i, seed) for i, o in enumerate(objects)]
        self._looked_for: set[str] = set()

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kind of every body, see :mod:`safety.geometry.shapes`."""
        return tuple(o.shape.kind for o in self.objects)

    def true(self, t: float) -> list[Obstacle]:
        """Every body as it really is at ``t`` [s]."""
        return [self._true(i, t) for i in range(len(self.objects))]

    def known(self, t: float) -> dict[str, Obstacle]:
        """The bodies that need no sensor at ``t`` [s], by name."""
        return {o.name: self._true(i, t) for i, o in enumerate(self.objects) if o.sensor is None}

    def physical(self, t: float) -> list[Shape]:
        """The bodies that the robot can touch, as the simulator has them at ``t`` [s]."""
        return [solid(self._true(i, t)) for i, o in enumerate(self.objects) if o.physical]

    def detections(self, t: float) -> list[Detection]:
        """What the sensors that are due report at ``t`` [s]: places with their noise, velocities without error."""
        found = (self._detection(i, t) for i, o in enumerate(self.objects) if o.sensor is not None)
        return [detection for detection in found if detection is not None]

    def _detection(self, index: int, t: float) -> Detection | None:
        body, motion, sensor = self.objects[index], self._motions[index], self._sensors[index]
        assert sensor is not None
        place = motion.position(t)
        measured = sensor.measure(place, t)
        # a body that is there from the start is looked for from the start
        first = body.name not in self._looked_for
        self._looked_for.add(body.name)
        if measured is None and not first:
            return None
        shape = body.shape.at(place if measured is None else measured, motion.velocity(t))
        return Detection(body.name, t, shape, seen=measured is not None)

    def tracking(self) -> dict[str, TrackingSettings]:
        """How each body that is seen is to be tracked, by name."""
        return {o.name: _tracking(o.sensor) for o in self.objects if o.sensor is not None}

    def _true(self, index: int, t: float) -> Obstacle:
        motion = self._motions[index]
        return self.objects[index].shape.at(motion.position(t), motion.velocity(t))


def _sensor(body: WorldObject, index: int, seed: int) -> PositionSensor | None:
    if body.sensor is None:
        return None
    stream = [seed, SENSOR_STREAM] if index == 0 else [seed, SENSOR_STREAM, index]
    lost_at = math.inf if body.sensor.lost_at is None else body.sensor.lost_at
    return PositionSensor(body.sensor.rate, body.sensor.noise, np.random.default_rng(stream), lost_at)


def _tracking(sensor: Sensor) -> TrackingSettings:
    # here, because the tracks' filter brings scipy.stats with it, which a run without obstacles need not wait for
    from controllers.obstacle_tracker import TrackingSettings
    from safety.tracking import TrackerSettings

    velocity = "measured" if sensor.velocity == "true" else sensor.velocity
    return TrackingSettings(TrackerSettings(position_noise=max(sensor.noise, 1e-4)), sensor.kappa, velocity)


def solid(body: Obstacle) -> Shape:
    """A body as the simulator has it; a half-space as a thick plate, ``PLATE`` to each side of its point."""
    if body.kind == "sphere":
        return Shape("sphere", (body.radius,), body.position)
    if body.kind == "box":
        return Shape("box", tuple(body.half_sizes.tolist()), body.position, body.rotation)
    length = float(np.linalg.norm(body.direction))
    axes = _axes_along(body.direction / length)
    if body.kind == "capsule":
        return Shape("capsule", (body.radius, 0.5 * length), body.position + 0.5 * body.direction, axes)
    return Shape("box", (PLATE, PLATE, THICK), body.position - THICK * body.direction, axes)


def _axes_along(z: Array) -> Array:
    """Axes (3, 3) in the columns, of which the last is ``z`` (3,), a unit vector."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


class RunWorld:
    """What a closed loop in MuJoCo has around the robot: bodies, and pushes on the torso.

    Args:
        plant: that is pushed, and that the physical bodies are in.
        agent: that is told the bodies that need no sensor.
        pushes: on the torso.
        bodies: around the robot.
    """

    def __init__(self, plant: MujocoPlant, agent: Agent, pushes: Sequence[Push], bodies: World) -> None:
        self._plant, self._agent, self._pushes, self._bodies = plant, agent, tuple(pushes), bodies

    def detections(self, t: float) -> Sequence[Detection]:
        """See :meth:`experiments.running.loop.World.detections`."""
        self._agent.known = self._bodies.known(t)
        return self._bodies.detections(t)

    def act(self, t: float) -> None:
        """See :meth:`experiments.running.loop.World.act`."""
        if self._pushes:
            self._plant.push(sum((push.at(t) for push in self._pushes), np.zeros(3)))
        if physical := self._bodies.physical(t):
            self._plant.place_bodies(physical)
