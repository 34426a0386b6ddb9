"""Kalman filters that estimate how obstacles move."""

import math
from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.special import chdtri

from robots.checks import all_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array

MODELS = ("constant_velocity", "constant_acceleration")
"""Motion models of a track: driven by white acceleration, or by white jerk."""


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of a track.

    The two noise densities are compromises for 5 mm noise at 30 to 100 Hz: steady motion wants them small, as the
    estimated velocity steps less with each measurement; a swerve wants them large, as the estimate lags and the gate
    takes good measurements for outliers. The two defaults step equally much. ``constant_acceleration`` then follows
    smooth curves more closely, ``constant_velocity`` sudden changes. The study in ``experiments.benchmarks.tracking``
    shows it.

    Attributes:
        position_noise: standard deviation of a measured coordinate [m].
        acceleration_noise: spectral density of the random acceleration of ``constant_velocity`` [m/s^1.5].
        initial_speed: standard deviation of each coordinate of the unknown initial velocity [m/s].
        max_age: a track that has accepted no measurement for longer is stale [s].
        model: one of ``MODELS``.
        jerk_noise: spectral density of the random jerk of ``constant_acceleration`` [m/s^2.5].
        initial_acceleration: standard deviation of the unknown initial acceleration of that model [m/s^2].
        gate: probability with which a measurement that agrees with the model is accepted, above 0; 1 accepts all.
        max_rejections: so many measurements in a row outside the gate restart the track from these, 1 or more.
        blending: time over which what a measurement changes is fed in [s]; 0: at once, see :class:`ObstacleTrack`.
        max_ahead: a track that has come further than this beyond the asked stamp is refused [s]: sensor and
            controller may differ by so much about what time it is.
    """

    position_noise: float = 0.005
    acceleration_noise: float = 0.3
    initial_speed: float = 1.0
    max_age: float = 0.2
    model: str = "constant_velocity"
    jerk_noise: float = 2.0
    initial_acceleration: float = 1.0
    gate: float = 0.99999
    max_rejections: int = 5
    blending: float = 0.01
    max_ahead: float = 0.02

    def __post_init__(self) -> None:
        positive = ("position_noise", "acceleration_noise", "initial_speed", "max_age", "jerk_noise", "max_ahead")
        for name in (*positive, "initial_acceleration"):
            require_positive(f"tracker {name}", getattr(self, name))
        require_non_negative("tracker blending", self.blending)
        require_one_of("tracker model", self.model, MODELS)
        if not (isinstance(self.gate, int | float) and 0 < self.gate <= 1):
            raise ConfigError("tracker gate", self.gate, "a probability above 0, at most 1")
        if not (isinstance(self.max_rejections, int) and self.max_rejections >= 1):
            raise ConfigError("tracker max_rejections", self.max_rejections, "a whole number, 1 or above")


class ObstacleTrack:
    r"""Position and velocity of one obstacle's centre from noisy positions, by a linear Kalman filter (filterpy).

    State [position; velocity], and acceleration where the model is ``constant_acceleration``. Time stamps may be
    irregular: the transition is built for each interval. A measurement is rejected as an outlier where

    .. math:: d^2 = y^T S^{-1} y > \chi^2_3(p_{gate})

    with y the innovation and S its covariance. When ``max_rejections`` in a row are outside the gate it is the track
    that is wrong: it restarts from these, which show where the obstacle is and how fast it moves.

    The three axes have equal noise, so they share one covariance: the filter's state has a column per axis, and its
    covariance is that of one axis.

    Every measurement moves the filter's state by a step, and a controller that is given it would step as well. So what
    is handed out goes there evenly over T (``blending``) from the time on at which the measurement came in:

    .. math:: y(t) = F(t - t_k)\,(x_k + (1 - \beta)(y_k^- - x_k)),\qquad \beta = \min(1, (t - t_k^{in}) / T)

    with x_k the filter's state after the measurement at t_k, and y_k^- what would have been handed out for t_k without
    it. Until the next tick nothing is handed out, so :math:`t_k^{in}` may be the tick before the measurement came:
    then a controller of period dt has its news (T - dt)/2 later than at once. The motion as it was known goes on
    without delay. For a filter whose model holds x_k errs independently of all that was measured, so the covariance of
    the error is known as well:

    .. math:: \Sigma(t) = F (P_k + (1 - \beta)^2 (\Sigma_k^- - P_k)) F^T + Q

    Source: the linear Kalman filter that gives v_O in eq. (48) of Lee et al. (their reference 33).

    Attributes:
        settings: as given.
        accepted: number of measurements taken in.
        rejected: number of measurements left out as outliers.
        restarts: how often the track was started anew.
        nis: normalised innovation squared d^2 of the last measurement; NaN before the second.
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        """Without a measurement the track has no estimate yet."""
        self.settings = settings or TrackerSettings()
        s = self.settings
        constant_velocity = s.model == "constant_velocity"
        self._order = 2 if constant_velocity else 3
        self._density = (s.acceleration_noise if constant_velocity else s.jerk_noise) ** 2
        self._threshold = float(chdtri(3, 1.0 - s.gate))
        self._filter: KalmanFilter | None = None
        self._time = self._accepted_at = -math.inf
        self._outside: list[tuple[Array, float]] = []
        self._received = -math.inf
        # by how much what was handed out differed from the filter's state, and its covariance, at the last measurement
        self._offset, self._excess = self._nothing_left()
        self.accepted = self.rejected = self.restarts = 0
        self.nis = math.nan

    def measure(self, position: Array | None, stamp: float, received: float | None = None) -> bool:
        """Take in a position (3,) [m] measured at ``stamp`` [s]; it is fed in from ``received`` on (not given: then).

        ``None`` is a measurement that is missing: time passes, and the track grows older.

        Returns:
            Whether a measurement was accepted.

        Raises:
            ConfigError: a number is not finite, the stamp is older than the last one, or ``received`` is further than
                ``max_age`` beyond it: no estimate could rest on it any more. The track is left as it was.
        """
        if position is not None and (np.shape(position) != (3,) or not all_finite(np.asarray(position, dtype=float))):
            raise ConfigError("measured position", position, "three finite numbers")
        if not math.isfinite(stamp) or stamp < self._time:
            raise ConfigError("measurement stamp", stamp, f"finite and not before {self._time:g} s")
        if received is None:
            received = stamp
        latest = stamp + self.settings.max_age
        if not math.isfinite(received) or received > latest:
            raise ConfigError("time at which a measurement came in", received, f"finite and at most {latest:g} s")
        self._advance(stamp)
        if position is None:
            return False
        z = np.array(position, dtype=float)
        if self._filter is not None and self._is_outlier(z):
            self._outside.append((z, stamp))
            if len(self._outside) < self.settings.max_rejections:
                self.rejected += 1
                return False
            self._restart()
        else:
            self._accept(z, stamp, received)
        self._outside.clear()
        self.accepted += 1
        return True

    def _accept(self, z: Array, stamp: float, received: float) -> None:
        """Update with ``z``; the first one starts the filter."""
        self._accepted_at = stamp
        if self._filter is None:
            self._filter = self._started(z)
            self._offset, self._excess = self._nothing_left()
            return
        left = self._left(received)
        handed_out, covariance = self._filter.x + left * self._offset, self._filter.P + left**2 * self._excess
        # H is passed again because filterpy would insist on one column where it is not
        self._filter.update(z[None, :], H=self._filter.H)
        self._filter.P = _symmetric(self._filter.P)
        self._offset, self._excess = handed_out - self._filter.x, _symmetric(covariance - self._filter.P)
        self._received = received

    def _left(self, t: float) -> float:
        """Fraction of the last measurement's news that is not handed out yet at ``t`` [s]."""
        blending = self.settings.blending
        return min(max(1.0 - (t - self._received) / blending, 0.0), 1.0) if blending > 0 else 0.0

    def _nothing_left(self) -> tuple[Array, Array]:
        """Offset and excess where the filter's state is what is handed out."""
        return np.zeros((self._order, 3)), np.zeros((self._order, self._order))

    def _started(self, z: Array) -> KalmanFilter:
        s = self.settings
        kf = KalmanFilter(dim_x=self._order, dim_z=1)
        kf.x = np.zeros((self._order, 3))
        kf.x[0] = z
        kf.H = np.eye(1, self._order)
        kf.R = np.array([[s.position_noise**2]])
        kf.P = np.diag(np.square([s.position_noise, s.initial_speed, s.initial_acceleration][: self._order]))
        return kf

    def _restart(self) -> None:
        """Start anew from the measurements outside the gate."""
        self._filter, self._time = None, -math.inf
        for z, stamp in self._outside:
            self._advance(stamp)
            self._accept(z, stamp, stamp)
        # the track was wrong: no way leads from there
        self._offset, self._excess = self._nothing_left()
        self.restarts += 1

    def _advance(self, stamp: float) -> None:
        if self._filter is not None and stamp > self._time:
            interval = stamp - self._time
            transition = _transition(interval, self._order)
            noise = Q_continuous_white_noise(self._order, interval, self._density)
            self._filter.predict(F=transition, Q=noise)
            self._offset = transition @ self._offset
            self._excess = transition @ self._excess @ transition.T
        self._time = stamp

    def _is_outlier(self, z: Array) -> bool:
        """Whether ``z`` (3,) is outside the gate of the filter, which must be at its time; sets ``nis``."""
        assert self._filter is not None
        innovation = z - self._filter.x[0]
        self.nis = float(innovation @ innovation) / float(self._filter.P[0, 0] + self._filter.R[0, 0])
        return self.nis > self._threshold

    def age(self, stamp: float) -> float:
        """Time since the last accepted measurement [s]; infinite without one, below 0 for one stamped ahead."""
        return stamp - self._accepted_at

    def fault(self, stamp: float) -> str | None:
        """Why the track cannot be used at ``stamp`` [s], in words; ``None`` where it can."""
        age, settings = self.age(stamp), self.settings
        if not age <= settings.max_age:
            return f"{age:.3g} s old, allowed are {settings.max_age:g} s"
        # also what was rejected or missing moves the track on in time
        ahead = self._time - stamp
        if not ahead <= settings.max_ahead:
            return f"{ahead:.3g} s ahead of the clock, allowed are {settings.max_ahead:g} s"
        return None

    def estimate(self, stamp: float) -> tuple[Array, Array]:
        """Position (3,) [m] and velocity (3,) [m/s] predicted to ``stamp``; the track itself is left as it is.

        A stamp before the last measurement gives the estimate at that measurement.

        Raises:
            ConfigError: no measurement yet, the last accepted one is older than ``max_age``, or the track is further
                than ``max_ahead`` beyond ``stamp``.
        """
        if self._filter is None or self.fault(stamp) is not None:
            s, age = self.settings, self.age(stamp)
            allowed = f"at most {s.max_age:g} s, and at most {s.max_ahead:g} s ahead"
            raise ConfigError("age of the obstacle track", stamp - self._time if age <= s.max_age else age, allowed)
        handed_out = self._filter.x + self._left(stamp) * self._offset
        x = _transition(max(stamp - self._time, 0.0), self._order) @ handed_out
        return x[0], x[1]

    def covariance(self, stamp: float) -> Array:
        """Covariance (6, 6) of [position; velocity] at ``stamp``, (9, 9) where the model has an acceleration.

        Raises:
            ConfigError: no measurement yet.
        """
        return np.asarray(np.kron(self._predicted_covariance(stamp), np.eye(3)), dtype=np.float64)

    def position_sigma(self, stamp: float) -> float:
        """Largest standard deviation of the position at ``stamp``, in any direction [m].

        That is the root of the largest eigenvalue of the covariance's position block, a multiple of the identity here.

        Raises:
            ConfigError: no measurement yet.
        """
        return math.sqrt(self._predicted_covariance(stamp)[0, 0])

    def _predicted_covariance(self, stamp: float) -> Array:
        """Covariance (order, order) of one axis at ``stamp``."""
        if self._filter is None:
            raise ConfigError("obstacle track", None, "measured at least once")
        interval = max(stamp - self._time, 0.0)
        transition = _transition(interval, self._order)
        noise = Q_continuous_white_noise(self._order, interval, self._density)
        covariance = self._filter.P + self._left(stamp) ** 2 * self._excess
        return _symmetric(transition @ covariance @ transition.T + noise)


def _symmetric(matrix: Array) -> Array:
    """``matrix`` without what rounding has made of its symmetry."""
    return 0.5 * (matrix + matrix.T)


def _transition(dt: float, order: int) -> Array:
    """Motion over ``dt`` [s] of [position, velocity, acceleration], the first ``order`` of them: (order, order)."""
    if order == 2:
        return np.array([[1.0, dt], [0.0, 1.0]])
    return np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
