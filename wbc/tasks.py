"""Operational-space tasks of KinWBC: a Jacobian and a commanded task velocity each."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.rotation import rotation_log


@dataclass(frozen=True, slots=True)
class TaskGains:
    r"""How task errors become task velocities.

    .. math:: \dot x^{cmd} = \dot x^{ref} + \operatorname{clip}(k\, e) + \ddot x^{ref} / a

    The last term carries a feed-forward acceleration through the velocity-to-acceleration law of DynWBC
    (eq. (15) of Lee et al.), for which :math:`a = K_d + K_p\,dt`.

    Attributes:
        k: error gain [1/s], above 0.
        max_correction: largest norm of the correction ``k e`` [m/s or rad/s], above 0.
        acceleration_gain: a [1/s], above 0.
    """

    k: float
    max_correction: float = 1.0
    acceleration_gain: float = 40.0

    def __post_init__(self) -> None:
        for name in ("k", "max_correction", "acceleration_gain"):
            require_positive(f"task {name}", getattr(self, name))

    def correction(self, error: Array) -> Array:
        """The correction velocity of an error (m,), its norm clipped."""
        v = self.k * error
        norm = math.sqrt(v @ v)
        return v if norm <= self.max_correction else v * (self.max_correction / norm)


class Task(ABC):
    r"""One task: ``rows`` rows; references are plain attributes, set before each tick.

    Attributes:
        rows: of the Jacobian.
        without_drift: take :math:`\dot J v / a` off the command, for eq. (15) of Lee et al. to give the acceleration
            that was asked for: at the level of velocities it does not know that term. Heeded by the CoM and by poses of
            frames; the kinematics' drift must then be up to date.
    """

    rows: int
    without_drift = False

    def __init__(self, gains: TaskGains) -> None:
        """Keep the gains."""
        self.gains = gains

    @abstractmethod
    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """Jacobian (rows, nv) and commanded task velocity (rows,) at the current kinematics, world axes."""


class CenterOfMassTask(Task):
    """Centre of mass to ``position`` with feed-forward ``velocity`` and ``acceleration``, each (3,), world."""

    rows = 3

    def __init__(self, gains: TaskGains) -> None:
        """References start at zero; set them."""
        super().__init__(gains)
        self.position = np.zeros(3)
        self.velocity = np.zeros(3)
        self.acceleration = np.zeros(3)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        command = self.velocity + self.gains.correction(self.position - kin.com)
        acceleration = self.acceleration - kin.com_drift if self.without_drift else self.acceleration
        return kin.com_jacobian, command + acceleration / self.gains.acceleration_gain


class FramePositionTask(Task):
    """Origin of a frame to ``position`` with feed-forward ``velocity`` and ``acceleration``, each (3,), world."""

    rows = 3

    def __init__(self, frame_id: int, gains: TaskGains) -> None:
        """``frame_id`` as given by :meth:`Kinematics.frame_id`."""
        super().__init__(gains)
        self.frame_id = frame_id
        self.position = np.zeros(3)
        self.velocity = np.zeros(3)
        self.acceleration = np.zeros(3)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        _, position = kin.frame_placement(self.frame_id)
        command = self.velocity + self.gains.correction(self.position - position)
        return kin.frame_jacobian(self.frame_id)[:3], command + self.acceleration / self.gains.acceleration_gain


class FrameOrientationTask(Task):
    """A frame's axes to ``rotation`` (3, 3) with feed-forward ``angular_velocity`` (3,), world."""

    rows = 3

    def __init__(self, frame_id: int, gains: TaskGains) -> None:
        """``frame_id`` as given by :meth:`Kinematics.frame_id`."""
        super().__init__(gains)
        self.frame_id = frame_id
        self.rotation = np.eye(3)
        self.angular_velocity = np.zeros(3)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        rotation, _ = kin.frame_placement(self.frame_id)
        error = rotation_log(self.rotation @ rotation.T)
        return kin.frame_jacobian(self.frame_id)[3:], self.angular_velocity + self.gains.correction(error)


class FramePoseTask(Task):
    """A frame to ``position`` (3,) and ``rotation`` (3, 3), world.

    Feed-forward ``velocity`` and ``acceleration``, (6,) each, linear first. ``gains`` are those of the position,
    ``angular_gains`` those of the orientation; their acceleration gain is the same.
    """

    rows = 6

    def __init__(self, frame_id: int, gains: TaskGains, angular_gains: TaskGains | None = None) -> None:
        """``frame_id`` as given by :meth:`Kinematics.frame_id`; ``angular_gains`` are ``gains`` if not given."""
        super().__init__(gains)
        self.angular_gains = gains if angular_gains is None else angular_gains
        self.frame_id = frame_id
        self.position = np.zeros(3)
        self.rotation = np.eye(3)
        self.velocity = np.zeros(6)
        self.acceleration = np.zeros(6)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        rotation, position = kin.frame_placement(self.frame_id)
        acceleration = self.acceleration
        if self.without_drift:
            acceleration = acceleration - kin.frame_drift(self.frame_id)
        command = self.velocity + acceleration / self.gains.acceleration_gain
        command[:3] += self.gains.correction(self.position - position)
        command[3:] += self.angular_gains.correction(rotation_log(self.rotation @ rotation.T))
        return kin.frame_jacobian(self.frame_id), command


class PostureTask(Task):
    """Joints to ``joints`` (nj,); the base is left alone."""

    def __init__(self, nj: int, gains: TaskGains, nv_base: int = 6) -> None:
        """For ``nj`` joints behind a base whose velocity has ``nv_base`` entries: see :class:`Kinematics`."""
        super().__init__(gains)
        self.rows = nj
        self.joints = np.zeros(nj)
        self._jacobian = np.hstack([np.zeros((nj, nv_base)), np.eye(nj)])

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        return self._jacobian, self.gains.correction(self.joints - kin.q[kin.nq_base :])
