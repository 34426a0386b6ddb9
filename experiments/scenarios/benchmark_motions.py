r"""How obstacles of the benchmarks move: SPARK's motion as it is coded, a true Brownian one, circles, or not at all.

SPARK's version 1.0 (``intelligent-control-lab/spark``, commit d36e32c) calls its motion Brownian. In every 500th step
of the controller, the first included, a direction d is drawn and given the length of the speed, which is one of metres
a step; in the others it is the last displacement. Each obstacle then moves by

.. math:: \Delta_k = 0.2\,\Delta_{k-1} + 0.8\,d_k, \qquad \Delta_{-1} = 0

and is put back into the box face by face, of which the displacement that is kept knows nothing. So it moves in a
straight line, by 0.8 of the speed in each step, and once it has met the box it slides along it. The velocity that
filters are told there has nothing to do with that: the speed, times three numbers that were drawn with its place.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.random import RandomState

from experiments.scenarios.benchmark_case import ObstacleDraw
from experiments.scenarios.benchmark_scene import DrawnScene
from robots.checks import require_positive
from robots.messages import Array

TURNS_EVERY = 500
"""Steps from one direction of SPARK's motion to the next."""

KEEPS = 0.2
"""How much of a displacement goes on into the next one there [-]."""

CIRCLE = 0.1
"""Radius of the circles [m]."""


class ObstacleMotion(Protocol):
    """Where obstacles are, step by step.

    Attributes:
        positions: shape (n, 3) centres now, world [m].
        velocities: shape (n, 3) by which they came here in the last step [m/s].
        told: shape (n, 3) what SPARK tells filters of their velocity [m/s].
    """

    positions: Array
    velocities: Array
    told: Array

    def step(self) -> None:
        """Go on by a period of the controller."""
        ...


class Still:
    """Obstacles that stay where they are; see :class:`ObstacleMotion`."""

    def __init__(self, scene: DrawnScene) -> None:
        """Where they were drawn."""
        self.positions = scene.obstacles.copy()
        self.velocities, self.told = np.zeros_like(self.positions), np.zeros_like(self.positions)

    def step(self) -> None:
        """See :meth:`ObstacleMotion.step`."""


class SparkMotion:
    """SPARK's motion as it is coded; see the module, and :class:`ObstacleMotion`."""

    def __init__(self, drawn: ObstacleDraw, scene: DrawnScene, dt: float) -> None:
        """Obstacle i has a generator of its own, of the scene's seed plus i; ``dt``: period of the controller [s]."""
        self._low, self._high, self._speed, self._dt = np.array(drawn.low), np.array(drawn.high), drawn.speed, dt
        self._generators = [RandomState(scene.seed + i) for i in range(len(scene.obstacles))]
        self.positions = scene.obstacles.copy()
        self._displacements = np.zeros_like(self.positions)
        self.velocities = np.zeros_like(self.positions)
        self.told = drawn.speed * scene.directions
        self._steps = 0

    def step(self) -> None:
        """See :meth:`ObstacleMotion.step`."""
        directions = self._displacements
        if self._steps % TURNS_EVERY == 0:
            directions = np.array([g.normal(size=3) for g in self._generators]).reshape(-1, 3)
            directions *= self._speed / np.linalg.norm(directions, axis=1, keepdims=True)
        self._displacements = KEEPS * self._displacements + (1.0 - KEEPS) * directions
        before = self.positions
        self.positions = np.clip(before + self._displacements, self._low, self._high)
        self.velocities = (self.positions - before) / self._dt
        self._steps += 1


class BrownianMotion:
    r"""Brownian motion that the faces of the box reflect; see :class:`ObstacleMotion`.

    .. math:: \Delta = \sigma \sqrt{dt}\, n, \qquad n \sim N(0, I)

    with :math:`\sigma` the speed [m/sqrt(s)]. A velocity in the usual sense it has none: what filters are told is zero.
    """

    def __init__(self, drawn: ObstacleDraw, scene: DrawnScene, dt: float) -> None:
        """Obstacle i has a generator of its own, of the scene's seed and i; ``dt``: period of the controller [s]."""
        require_positive("dt", dt)
        self._low, self._high = np.array(drawn.low), np.array(drawn.high)
        self._deviation, self._dt = drawn.speed * np.sqrt(dt), dt
        self._generators = [np.random.default_rng([scene.seed, i]) for i in range(len(scene.obstacles))]
        self.positions = scene.obstacles.copy()
        self.velocities, self.told = np.zeros_like(self.positions), np.zeros_like(self.positions)

    def step(self) -> None:
        """See :meth:`ObstacleMotion.step`."""
        before = self.positions
        drawn = np.array([g.standard_normal(3) for g in self._generators]).reshape(-1, 3)
        self.positions = reflected(before + self._deviation * drawn, self._low, self._high)
        self.velocities = (self.positions - before) / self._dt


class CircleMotion:
    """Level circles of radius ``CIRCLE`` through the places drawn, at the speed [m/s]; see :class:`ObstacleMotion`."""

    def __init__(self, drawn: ObstacleDraw, scene: DrawnScene, dt: float) -> None:
        """Centres lie where each first number of the directions has them; ``dt``: period of the controller [s]."""
        angle = np.pi * scene.directions[:, :1]
        self._phase, self._rate, self._dt, self._time = angle, drawn.speed / CIRCLE, dt, 0.0
        self._centres = scene.obstacles - self._arms(0.0)
        self.positions = scene.obstacles.copy()
        self.velocities = self._velocities(0.0)
        self.told = self.velocities

    def _arms(self, t: float) -> Array:
        turned = self._phase + self._rate * t
        return CIRCLE * np.hstack([np.cos(turned), np.sin(turned), np.zeros_like(turned)])

    def _velocities(self, t: float) -> Array:
        turned = self._phase + self._rate * t
        return CIRCLE * self._rate * np.hstack([-np.sin(turned), np.cos(turned), np.zeros_like(turned)])

    def step(self) -> None:
        """See :meth:`ObstacleMotion.step`."""
        self._time += self._dt
        self.positions = self._centres + self._arms(self._time)
        self.velocities = self.told = self._velocities(self._time)


def reflected(positions: Array, low: Array, high: Array) -> Array:
    """Positions (n, 3) that left a box folded back into it by its faces, as often as it takes."""
    width = high - low
    folded = np.mod(positions - low, 2.0 * np.where(width > 0.0, width, 1.0))
    return np.where(width > 0.0, low + np.minimum(folded, 2.0 * width - folded), low)


def motion_of(drawn: ObstacleDraw, scene: DrawnScene, dt: float) -> ObstacleMotion:
    """The motion of a case's obstacles; ``dt``: period of the controller, above 0 [s].

    Raises:
        ConfigError: ``dt`` is not above 0.
    """
    require_positive("dt", dt)
    moving: dict[str, Callable[[ObstacleDraw, DrawnScene, float], ObstacleMotion]] = {
        "spark": SparkMotion,
        "brownian": BrownianMotion,
        "circle": CircleMotion,
    }
    return moving[drawn.motion](drawn, scene, dt) if drawn.motion in moving else Still(scene)
