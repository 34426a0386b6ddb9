"""Kalman filters that estimate how obstacles move."""

import math
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter

from robots.checks import all_finite, require_positive
from robots.errors import ConfigError
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of a constant-velocity track.

    Attributes:
        position_noise: standard deviation of a measured coordinate [m].
        acceleration_noise: spectral density of the random acceleration [m/s^1.5].
        initial_speed: standard deviation of the unknown initial velocity [m/s].
        max_age: a track without measurement for longer is stale [s].
    """

    position_noise: float = 0.005
    acceleration_noise: float = 0.3
    initial_speed: float = 1.0
    max_age: float = 0.2

    def __post_init__(self) -> None:
        for name in ("position_noise", "acceleration_noise", "initial_speed", "max_age"):
            require_positive(f"tracker {name}", getattr(self, name))


class ObstacleTrack:
    """Position and velocity of one obstacle's centre from noisy positions, by a linear Kalman filter (filterpy).

    State [position; velocity], constant-velocity model with white random acceleration; irregular time stamps are
    handled by building the transition for each interval.

    Source: the linear Kalman filter that gives v_O in eq. (48) of Lee et al. (their reference 33).
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        """Without a measurement the track has no estimate yet."""
        self.settings = settings or TrackerSettings()
        self._filter: KalmanFilter | None = None
        self._time = -math.inf
        self._measured_at = -math.inf

    def measure(self, position: Array, stamp: float) -> None:
        """Take in one measured position (3,) [m] taken at ``stamp`` [s].

        Raises:
            ConfigError: a number is not finite, or the stamp is older than the last one.
        """
        if np.shape(position) != (3,) or not all_finite(np.asarray(position, dtype=float)):
            raise ConfigError("measured position", position, "three finite numbers")
        if not math.isfinite(stamp) or stamp < self._measured_at:
            raise ConfigError("measurement stamp", stamp, f"finite and not before {self._measured_at:g} s")
        if self._filter is None:
            self._start(position, stamp)
            return
        self._advance(stamp)
        self._filter.update(position)
        self._measured_at = stamp

    def _start(self, position: Array, stamp: float) -> None:
        s = self.settings
        kf = KalmanFilter(dim_x=6, dim_z=3)
        kf.x = np.concatenate([position, np.zeros(3)]).reshape(6, 1)
        kf.H = np.hstack([np.eye(3), np.zeros((3, 3))])
        kf.R = s.position_noise**2 * np.eye(3)
        kf.P = np.diag([s.position_noise**2] * 3 + [s.initial_speed**2] * 3)
        self._filter = kf
        self._time = self._measured_at = stamp

    def _advance(self, stamp: float) -> None:
        assert self._filter is not None
        dt = stamp - self._time
        if dt <= 0:
            return
        self._filter.predict(F=_transition(dt), Q=_process_noise(dt, self.settings.acceleration_noise))
        self._time = stamp

    def age(self, stamp: float) -> float:
        """Time since the last measurement [s]; infinite without one."""
        return stamp - self._measured_at

    def estimate(self, stamp: float) -> tuple[Array, Array]:
        """Position (3,) [m] and velocity (3,) [m/s] predicted to ``stamp``; the track itself is left as it is.

        Raises:
            ConfigError: no measurement yet, or the last one is older than ``max_age``.
        """
        age = self.age(stamp)
        if self._filter is None or not age <= self.settings.max_age:
            raise ConfigError("age of the obstacle track", age, f"at most {self.settings.max_age:g} s")
        x = (_transition(max(stamp - self._time, 0.0)) @ self._filter.x).ravel()
        return x[:3], x[3:]

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of [position; velocity] at the last measurement."""
        if self._filter is None:
            raise ConfigError("obstacle track", None, "measured at least once")
        return np.array(self._filter.P)


def _transition(dt: float) -> Array:
    f = np.eye(6)
    f[:3, 3:] = dt * np.eye(3)
    return f


def _process_noise(dt: float, density: float) -> Array:
    eye = np.eye(3)
    block = np.block([[dt**3 / 3 * eye, dt**2 / 2 * eye], [dt**2 / 2 * eye, dt * eye]])
    return density**2 * block
