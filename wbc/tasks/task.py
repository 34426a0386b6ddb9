"""What a task is, and how its errors become velocities."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from robots.checks import require_positive
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array

FLOAT = np.dtype(np.float64)


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
        max_change: by how much the correction of a frame's position may change from one evaluation to the next [m/s],
            above 0; infinite: by anything. It keeps a target that jumps from becoming a velocity that does.
    """

    k: float
    max_correction: float = 1.0
    acceleration_gain: float = 40.0
    max_change: float = math.inf

    def __post_init__(self) -> None:
        for name in ("k", "max_correction", "acceleration_gain"):
            require_positive(f"task {name}", getattr(self, name))
        if not self.max_change > 0:
            raise ConfigError("task max_change", self.max_change, "a number above 0, or infinity")

    def correction(self, error: Array) -> Array:
        """The correction velocity of an error (m,), its norm clipped."""
        v = self.k * error
        norm = math.sqrt(v @ v)
        return v if norm <= self.max_correction else v * (self.max_correction / norm)


class Task(ABC):
    r"""One task: ``rows`` rows, and a target that is set before each tick, or once.

    A task of one's own derives from this class, sets ``rows`` and gives :meth:`evaluate`; with a target, it says in
    ``is_set`` whether it has one, and takes it in ``set_target``.

    Attributes:
        rows: of the Jacobian.
    """

    rows: int

    def __init__(self, gains: TaskGains, *, name: str = "", compensate_bias: bool = False) -> None:
        r"""Keep gains and name.

        Args:
            gains: how errors become velocities.
            name: by which a stack of tasks finds it, and in errors; without one, that of its class.
            compensate_bias: whether to take the bias acceleration :math:`\dot J v`, over ``acceleration_gain``, off the
                command, for eq. (15) of Lee et al. to give the acceleration that was asked for: at the level of
                velocities it does not know that term. Heeded by the CoM and by tasks about frames; the kinematics'
                ``update_bias_acceleration`` must then be called before.
        """
        self._gains, self._compensate_bias = gains, compensate_bias
        self._name = name or type(self).__name__

    @property
    def name(self) -> str:
        """By which a stack of tasks finds it."""
        return self._name

    @property
    def gains(self) -> TaskGains:
        """How errors become velocities; see :meth:`set_gains`."""
        return self._gains

    @property
    def compensate_bias(self) -> bool:
        """Whether the bias acceleration is taken off the command."""
        return self._compensate_bias

    @property
    def is_set(self) -> bool:
        """Whether the task knows where to go; one without a target always does."""
        return True

    def set_gains(self, gains: TaskGains) -> None:
        """Take other gains from the next evaluation on."""
        self._gains = gains

    def set_target(self, *args: Any, **kwargs: Any) -> None:
        """Take a target from the next evaluation on; what it consists of is up to the task.

        Raises:
            ConfigError: a part of it has another shape than it must have.
        """
        raise NotImplementedError(f"{type(self).__name__} has no set_target")

    @abstractmethod
    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """Jacobian (rows, nv) and commanded task velocity (rows,) at the current kinematics, world axes.

        Raises:
            TargetNotSetError: the target was never set.
        """

    def shaped(self, part: str, value: Any, *shape: int) -> Array:
        """``value`` as an array of numbers, itself where it is one; what has another shape is refused."""
        if type(value) is np.ndarray and value.shape == shape and value.dtype is FLOAT:
            return value
        array = np.ascontiguousarray(value, dtype=float)
        if array.shape != shape:
            raise ConfigError(f"{part} of task {self._name}", value, f"of shape {shape}")
        return array
