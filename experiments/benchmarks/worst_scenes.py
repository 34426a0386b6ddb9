"""What a tick may be given at its worst: obstacles that jump, spin, race and press, and targets out of reach."""

from dataclasses import dataclass

import numpy as np

from controllers.reference import WholeBodyReference
from robots.messages import Array
from safety.geometry.shapes import Obstacle

TARGET_TICKS = 100
"""Targets that jump do so after as many ticks."""

TARGET_JUMP = 1.0
"""How far a hand's target is put from its path along each axis at most [m], the CoM's half as far; a jump may be twice
that."""

SPHERE_RADIUS, CAPSULE_RADIUS, CAPSULE_LENGTH = 0.03, 0.04, 0.4
"""Of spheres and capsules [m]."""

SMALLEST, LARGEST = 0.02, 0.2
"""Half sizes of boxes are between these [m]."""

CLUSTERS = 5
"""How many clusters there are."""

CLUSTER = (-12.0, -3.0)
"""Spheres of a cluster are 10 to a power between these from its middle [m]."""

UP = np.array([0.0, 0.0, 1.0])
"""Out of the ground."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One adversarial sequence: how its obstacles are drawn, and what else happens.

    Attributes:
        name: of the sequence.
        kinds: of the obstacles.
        speed: least and largest speed [m/s]; drawn evenly in its logarithm, 0 stands still.
        angular_velocity: size of the angular velocity, about an axis that is drawn [rad/s].
        every: an obstacle is drawn anew after as many ticks.
        spread: how far from a body it is put, standard deviation [m].
        layout: ``around`` the bodies, ``shell`` at a fixed distance round the first of them, ``cluster`` on nearly the
            same spot, ``rising`` from below the feet, ``facing`` pairs that close on a body from both sides.
        nearest: how many of the robot's collision bodies, those nearest to the left hand, avoid them; 0: all.
        targets: whether the targets of hands and CoM jump.
    """

    name: str
    kinds: tuple[str, ...]
    speed: tuple[float, float] = (0.0, 0.0)
    angular_velocity: float = 0.0
    every: int = 50
    spread: float = 0.15
    layout: str = "around"
    nearest: int = 0
    targets: bool = False


SCENES = (
    Scene("boxes turn at 20 rad/s", ("box",) * 5, angular_velocity=20.0, every=125),
    Scene("boxes jump", ("box",) * 5, every=3),
    Scene("capsules jump and turn", ("capsule",) * 7, angular_velocity=20.0, every=10),
    Scene("5 m/s to 100 km/s", ("box",) * 2 + ("capsule",) * 3 + ("sphere",) * 6, (5.0, 1e5), 20.0, 7),
    Scene("200 spheres round a hand", ("sphere",) * 200, every=60, spread=0.12, layout="shell", nearest=3),
    Scene("half-spaces rise", ("half_space",) * 12, (0.5, 0.5), every=250, spread=0.3, layout="rising"),
    Scene("rows in conflict", ("half_space",) * 6 + ("box",) * 2 + ("sphere",) * 6, (0.1, 1.0), layout="facing"),
    Scene("rows nearly dependent", ("sphere",) * 35, every=40, spread=0.08, layout="cluster"),
    Scene("targets jump by metres", (), targets=True),
    Scene("all at once", ("box", "capsule", "sphere", "half_space") * 2, (0.1, 10.0), 20.0, 20, targets=True),
)
"""The sequences of ``safewbc bench worst``; the G1 has at most 990 rows in them."""


class Adversary:
    """Plays one scene around the robot's bodies.

    Args:
        scene: what happens.
        dt: period of the ticks [s].
        rng: all that is drawn.
    """

    def __init__(self, scene: Scene, dt: float, rng: np.random.Generator) -> None:
        self.scene = scene
        self._dt, self._rng = dt, rng
        self._obstacles: list[Obstacle] = []
        self._targets = np.zeros((3, 3))
        self._tick = self._since_jump = 0

    def restart(self) -> None:
        """A new start: everything is drawn anew at the next step."""
        self._tick = self._since_jump = 0
        self._obstacles = []

    def obstacles(self, spots: Array) -> list[Obstacle]:
        """Those of the next tick; ``spots`` (n, 3) are where bodies of the robot are, the left hand first [m]."""
        count = len(self.scene.kinds)
        anew = not self._obstacles
        if anew:
            self._obstacles = [self._draw(i, spots) for i in range(count)]
        for i, obstacle in enumerate(self._obstacles):
            # each at its turn, so that some obstacle changes in nearly every tick
            if not anew and (self._tick + i) % self.scene.every == 0:
                self._obstacles[i] = self._draw(i, spots)
            elif self.scene.speed[1] or self.scene.angular_velocity:
                self._obstacles[i] = obstacle.after(self._dt)
        self._tick += 1
        return self._obstacles

    def retarget(self, reference: WholeBodyReference) -> None:
        """Moves the references of hands and CoM to where the targets have jumped; call it once a tick, after a motion.

        Velocities stay as they are: the jump is in the positions alone.
        """
        if not self.scene.targets:
            return
        if self._since_jump % TARGET_TICKS == 0:
            self._targets = self._rng.uniform(-TARGET_JUMP, TARGET_JUMP, (3, 3))
            self._targets[2] *= 0.5
        self._since_jump += 1
        assert reference.hands is not None
        for hand, jump in zip(reference.hands, self._targets[:2], strict=True):
            hand.position = hand.position + jump
        reference.com.position = reference.com.position + self._targets[2]

    def _draw(self, index: int, spots: Array) -> Obstacle:
        """Obstacle number ``index``, where the scene's layout puts it."""
        layouts = {
            "around": self._around,
            "shell": self._on_shell,
            "cluster": self._in_cluster,
            "rising": self._rising,
            "facing": self._facing,
        }
        place, normal, velocity = layouts[self.scene.layout](index, spots)
        angular_velocity = self.scene.angular_velocity * _direction(self._rng)
        return _obstacle(self.scene.kinds[index], place, normal, velocity, angular_velocity, self._rng)

    def _around(self, index: int, spots: Array) -> tuple[Array, Array, Array]:
        """Place, normal and velocity, (3,) each, beside a body; what is fast comes by before it is drawn again."""
        scene, rng = self.scene, self._rng
        away, velocity = _direction(rng), self._speed() * _direction(rng)
        place = spots[rng.integers(len(spots))] + scene.spread * rng.normal() * away
        until = self._dt * rng.uniform(0.0, 0.5 * scene.every)
        return (place - until * velocity if scene.speed[1] > 1.0 else place), away, velocity

    def _on_shell(self, index: int, spots: Array) -> tuple[Array, Array, Array]:
        away = _direction(self._rng)
        return spots[0] + self.scene.spread * away, away, self._speed() * _direction(self._rng)

    def _in_cluster(self, index: int, spots: Array) -> tuple[Array, Array, Array]:
        """In one of ``CLUSTERS`` about the first body."""
        away = _direction(self._rng)
        middle = spots[0] + self.scene.spread * self._shared(index % CLUSTERS)
        place = middle + 10.0 ** self._rng.uniform(*CLUSTER) * away
        return place, away, self._speed() * _direction(self._rng)

    def _rising(self, index: int, spots: Array) -> tuple[Array, Array, Array]:
        scene, rng = self.scene, self._rng
        spot = spots[rng.integers(len(spots))]
        normal = _unit(UP + scene.spread * rng.normal(size=3))
        return np.array([spot[0], spot[1], -scene.spread * rng.random()]), normal, self._speed() * UP

    def _facing(self, index: int, spots: Array) -> tuple[Array, Array, Array]:
        """On one side of a body or, for every second one, on the other; free where the body is, and coming closer."""
        pair = index // 2
        away = self._shared(pair) if index % 2 else -self._shared(pair)
        place = spots[pair % len(spots)] + self.scene.spread * self._rng.random() * away
        return place, -away, -self._speed() * away

    def _shared(self, number: int) -> Array:
        """A direction (3,) that obstacles drawn in the same stretch of ticks have in common, by its number."""
        return _direction(np.random.default_rng([number, self._tick // self.scene.every]))

    def _speed(self) -> float:
        low, high = self.scene.speed
        return float(np.exp(self._rng.uniform(np.log(low), np.log(high)))) if low > 0 else high


def _obstacle(
    kind: str, place: Array, normal: Array, velocity: Array, angular_velocity: Array, rng: np.random.Generator
) -> Obstacle:
    """An obstacle of this kind about ``place`` (3,); what else it needs is drawn."""
    if kind == "sphere":
        return Obstacle.sphere(place, SPHERE_RADIUS, velocity)
    if kind == "capsule":
        half = 0.5 * CAPSULE_LENGTH * _direction(rng)
        return Obstacle.capsule(place - half, place + half, CAPSULE_RADIUS, velocity, angular_velocity)
    if kind == "half_space":
        return Obstacle.half_space(place, normal, velocity, angular_velocity)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)
    return Obstacle.box(place, axes, rng.uniform(SMALLEST, LARGEST, 3), velocity, angular_velocity)


def _direction(rng: np.random.Generator) -> Array:
    return _unit(rng.normal(size=3))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)
