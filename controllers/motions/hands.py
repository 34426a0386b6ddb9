"""Motions: what changes in the whole-body reference with time."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.motions.quintic import quintic
from controllers.reference import PointReference, WholeBodyReference
from robots.checks import require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.messages import Array

MIRROR = np.array([1.0, -1.0, 1.0])
"""Left to right."""


class Motion(Protocol):
    """Changes parts of the reference with time."""

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """Set its parts of ``reference`` for time ``t`` [s]."""
        ...


@dataclass(frozen=True, slots=True)
class CircleSettings:
    """A circle of the left hand; the right hand mirrors it.

    Attributes:
        radius: above 0 [m].
        inward: shape (3,) direction from the hand's place to the circle's centre, world; any length.
        upward: shape (3,) direction in which the circle starts; made perpendicular to ``inward``.
        period: of one turn, above 0 [s].
        start: time over which the hand gets up to speed, above 0 [s].
    """

    radius: float
    inward: Array
    upward: Array
    period: float
    start: float = 1.0

    def __post_init__(self) -> None:
        for name in ("radius", "period", "start"):
            require_positive(f"circle {name}", getattr(self, name))
        for name in ("inward", "upward"):
            value = getattr(self, name)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ConfigError(f"circle {name}", value.tolist(), "three finite numbers")
        if np.linalg.norm(np.cross(self.inward, self.upward)) < 1e-6:
            raise ConfigError("circle inward, upward", (self.inward, self.upward), "two different directions")


def circle_settings(robot: RobotDescription) -> CircleSettings:
    """The circle of ``[tuning.hand_tracking]`` in the description.

    Raises:
        DescriptionError: the table or one of its fields is missing, or a direction is no list of numbers.
        ConfigError: a value is not allowed.
    """
    table = robot.tuning.get("hand_tracking", {})
    fields = ("radius", "inward", "upward", "period")
    if missing := [f for f in fields if f not in table]:
        raise DescriptionError(robot.file, "tuning.hand_tracking: missing", missing, "given: " + ", ".join(fields))
    try:
        inward, upward = (np.array(table[k], dtype=float) for k in ("inward", "upward"))
    except (TypeError, ValueError) as error:
        given = [table[k] for k in ("inward", "upward")]
        raise DescriptionError(
            robot.file, "tuning.hand_tracking: inward, upward", given, "three numbers each"
        ) from error
    return CircleSettings(table["radius"], inward, upward, table["period"])


class HandCircles:
    r"""Both hands on 3D circles.

    .. math:: p(t) = p_0 + r\,[(1 - \cos\varphi)\, u + \sin\varphi\, w],\quad \dot\varphi \to 2\pi / T

    Half a turn takes the hand to :math:`p_0 + 2 r u`, which is to lie inside the torso: the hand-trajectory-tracking
    scenario of section 5.2.1 of Lee et al.
    """

    def __init__(self, settings: CircleSettings, hands: tuple[Array, Array]) -> None:
        """``hands``: where left and right hand start, (3,) each [m]."""
        self._settings = settings
        u = settings.inward / np.linalg.norm(settings.inward)
        w = settings.upward - u * (u @ settings.upward)
        self._axes = (u, w / np.linalg.norm(w))
        self._start = hands

    @classmethod
    def for_robot(cls, robot: RobotDescription, reference: WholeBodyReference) -> "HandCircles":
        """The circles of the description, from where ``reference`` has the hands: what an agent makes the motion from.

        Raises:
            ConfigError: the reference has no hands, or a value of the description is not allowed.
            DescriptionError: the description has no circle.
        """
        if reference.hands is None:
            raise ConfigError("hands", None, "tasks of the agent: with_hands=True")
        left, right = reference.hands
        return cls(circle_settings(robot), (left.position.copy(), right.position.copy()))

    def _phase(self, t: float) -> tuple[float, float, float]:
        """Angle [rad] and its two rates: the speed rises over ``start`` as (1 - cos) / 2."""
        s = self._settings
        speed = 2 * np.pi / s.period
        if t >= s.start:
            return speed * (t - 0.5 * s.start), speed, 0.0
        k = np.pi / s.start
        return (
            speed * (0.5 * t - np.sin(k * t) / (2 * k)),
            speed * 0.5 * (1 - np.cos(k * t)),
            speed * 0.5 * k * np.sin(k * t),
        )

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`Motion.apply`."""
        angle, rate, acceleration = self._phase(t)
        u, w = self._axes
        r, sine, cosine = self._settings.radius, np.sin(angle), np.cos(angle)
        first = r * (sine * u + cosine * w)
        second = r * (cosine * u - sine * w)
        position = r * ((1 - cosine) * u + sine * w)
        velocity = first * rate
        curve = second * rate**2 + first * acceleration
        left, right = self._start
        reference.hands = (
            PointReference(left + position, velocity, curve),
            PointReference(right + MIRROR * position, MIRROR * velocity, MIRROR * curve),
        )


class CenterOfMassShift:
    """The CoM from ``start`` to ``target``, (3,) each [m], on a quintic over ``duration`` [s]."""

    def __init__(self, start: Array, target: Array, duration: float) -> None:
        require_positive("duration of the CoM shift", duration)
        self._start = start
        self._way = target - start
        self._duration = duration

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`Motion.apply`."""
        value, rate, second = quintic(t, self._duration)
        reference.com = PointReference(self._start + value * self._way, rate * self._way, second * self._way)


class HandsToTargets:
    """Both hands to fixed targets (3,) each [m], on a quintic in time, then held."""

    def __init__(self, hands: tuple[Array, Array], targets: tuple[Array, Array], duration: float) -> None:
        require_positive("duration of the hand motion", duration)
        self._hands = hands
        self._targets = targets
        self._duration = duration

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`Motion.apply`."""
        value, rate, second = quintic(t, self._duration)
        left, right = (
            PointReference(a + value * (b - a), rate * (b - a), second * (b - a))
            for a, b in zip(self._hands, self._targets, strict=True)
        )
        reference.hands = (left, right)


class HandsAt:
    """Both hands to fixed targets (3,) each [m] in one jump: what a gain on the error and its bound make of it."""

    def __init__(self, targets: tuple[Array, Array]) -> None:
        self._targets = targets

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`Motion.apply`."""
        left, right = (PointReference(target, np.zeros(3), np.zeros(3)) for target in self._targets)
        reference.hands = (left, right)


class CarriedHands:
    r"""Both hands carried along: at fixed places beside the CoM's reference, in axes that turn with the heading.

    .. math:: p = c + R_z(\psi)\, r,\quad \dot p = \dot c + \dot\psi\, z \times R_z(\psi)\, r

    To be applied after what moves CoM and heading. The heading is that of the base's reference.
    """

    def __init__(self, reference: WholeBodyReference) -> None:
        """Keep the hands where ``reference`` has them now, as seen from its CoM and heading.

        Raises:
            ConfigError: the reference has no hands.
        """
        if reference.hands is None:
            raise ConfigError("hands", None, "given by the reference")
        back = heading_axes(reference).T
        left, right = (back @ (hand.position - reference.com.position) for hand in reference.hands)
        self._places = (left, right)

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`Motion.apply`."""
        axes, rate, com = heading_axes(reference), reference.turn_rate, reference.com
        left, right = (axes @ place for place in self._places)
        reference.hands = (_carried(com, left, rate), _carried(com, right, rate))


def heading_axes(reference: WholeBodyReference) -> Array:
    """Rotation (3, 3) about the vertical that has the direction of the base's forward axis."""
    c, s = reference.base_rotation[:2, 0] / np.linalg.norm(reference.base_rotation[:2, 0])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _carried(com: PointReference, arm: Array, rate: float) -> PointReference:
    """A point at ``arm`` (3,) [m] from ``com`` that turns about its vertical at ``rate`` [rad/s]."""
    across = np.array([-arm[1], arm[0], 0.0])
    inward = np.array([arm[0], arm[1], 0.0])
    return PointReference(com.position + arm, com.velocity + rate * across, com.acceleration - rate**2 * inward)
