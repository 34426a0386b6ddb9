r"""Contact-aided invariant extended Kalman filter: where the base is, from IMU and leg kinematics.

The state is the IMU's rotation R, velocity v and position p in the world, the position d_i and rotation R_i of each
sole, and the biases of gyro and accelerometer. Its error is right-invariant, with hats on estimates,

.. math:: \hat R = \exp(\xi_R) R, \quad \hat v = \exp(\xi_R) v + \xi_v, \quad \hat p = \exp(\xi_R) p + \xi_p, \quad
    \hat d_i = \exp(\xi_R) d_i + \xi_{d_i}, \quad \hat R_i = \exp(\xi_{R_i}) R_i, \quad \hat b = b + \zeta

to first order in all but :math:`\xi_R`. With the measured rate :math:`\tilde\omega` and specific force
:math:`\tilde a`, without their biases, and the gravity g,

.. math:: \dot R = R \tilde\omega^\times, \quad \dot v = R \tilde a + g, \quad \dot p = v, \quad
    \dot d_i = w_{d_i}, \quad \dot R_i = w_{R_i}^\times R_i, \quad \dot b = w_b

    \dot\xi_R = -\hat R \zeta_g, \quad \dot\xi_v = g^\times \xi_R - \hat v^\times \hat R \zeta_g - \hat R \zeta_a, \quad
    \dot\xi_p = \xi_v - \hat p^\times \hat R \zeta_g, \quad \dot\xi_{d_i} = -\hat d_i^\times \hat R \zeta_g

The error's dynamics depend on the estimate through the biases only, and the leg kinematics, which say where a sole is
in the IMU's axes, :math:`y = R^T (d_i - p)` and :math:`Y = R^T R_i`, correct it by

.. math:: \hat R y - (\hat d_i - \hat p) = \xi_p - \xi_{d_i}, \qquad
    \log(\hat R Y \hat R_i^T) = \xi_R - \xi_{R_i}

in which no estimate appears at all: a filter that starts wrong converges as one that starts right.

Source: Hartley, Ghaffari, Eustice and Grizzle, *Contact-aided invariant extended Kalman filtering for robot state
estimation*, IJRR 39(4), 2020: the state, the right-invariant error, its dynamics with IMU biases, the correction by
forward kinematics. Rotations of the soles as states, since soles are flat and not points: Rotella, Bloesch, Righetti
and Schaal, *State estimation for a humanoid robot*, IROS 2014. Feet in the air stay in the state, with so much noise
that their kinematics tell where they are; there they are added and taken out.
"""

from dataclasses import dataclass

import numpy as np

from controllers.estimation.kernels import correct_covariance, predict_covariance
from controllers.estimation.rotations import exponential, left_jacobian, logarithm, skew
from robots.checks import require_non_negative, require_positive
from robots.messages import Array, Mask
from wbc.wrench import GRAVITY

ROTATION, VELOCITY, POSITION, GYRO_BIAS, ACCELEROMETER_BIAS = (slice(i, i + 3) for i in (0, 3, 6, 9, 12))
"""Places in the error; then position and rotation of the left sole and of the right one."""

SIZE = 27
"""Of the error."""

DOWN = np.array([0.0, 0.0, -GRAVITY])


def sole_position(foot: int) -> slice:
    """Place in the error of where a sole is, 0 left, 1 right."""
    return slice(15 + 6 * foot, 18 + 6 * foot)


def sole_rotation(foot: int) -> slice:
    """Place in the error of how a sole is turned."""
    return slice(18 + 6 * foot, 21 + 6 * foot)


@dataclass(frozen=True, slots=True)
class FilterNoise:
    """What the filter takes its sensors and its soles to be; densities of white noise, and deviations.

    Attributes:
        gyro: density of the rate's noise [rad/s/sqrt(Hz)].
        accelerometer: density of the specific force's noise [m/s^2/sqrt(Hz)].
        gyro_drift: density of what the gyro's bias changes by [rad/s^2/sqrt(Hz)].
        accelerometer_drift: the same of the accelerometer's [m/s^3/sqrt(Hz)].
        slip: density of the velocity of a sole that stands [m/s/sqrt(Hz)].
        twist: density of its rate of turning [rad/s/sqrt(Hz)].
        swing: density of the velocity, and of the rate, of a sole in the air [m/s/sqrt(Hz), rad/s/sqrt(Hz)].
        kinematics: deviation of a sole's position by the leg [m].
        kinematics_rotation: deviation of its rotation [rad].
        ground: deviation of a standing sole from the ground's height [m].
        level: deviation of a standing sole from level [rad].
        start_tilt: deviation of roll and pitch at the start [rad].
        start_gyro_bias: deviation of the gyro's bias at the start [rad/s].
        start_accelerometer_bias: the same of the accelerometer's [m/s^2].
    """

    gyro: float = 2.5e-4
    accelerometer: float = 3e-3
    gyro_drift: float = 2e-5
    accelerometer_drift: float = 1e-4
    slip: float = 2e-3
    twist: float = 5e-3
    swing: float = 3.0
    kinematics: float = 1e-3
    kinematics_rotation: float = 2e-3
    ground: float = 3e-3
    level: float = 0.01
    start_tilt: float = 0.02
    start_gyro_bias: float = 1e-3
    start_accelerometer_bias: float = 0.05

    def __post_init__(self) -> None:
        for name in self.__slots__:
            check = require_non_negative if name.endswith("drift") or name.startswith("start") else require_positive
            check(f"filter noise {name}", getattr(self, name))


class InvariantFilter:
    """The filter; see the module.

    Attributes:
        rotation: R, shape (3, 3): from the IMU's axes to the world's.
        velocity: v (3,) of the IMU in the world [m/s].
        position: p (3,) of the IMU in the world [m].
        sole_positions: d, shape (2, 3), left first [m].
        sole_rotations: R_i, shape (2, 3, 3).
        gyro_bias: shape (3,) [rad/s].
        accelerometer_bias: shape (3,) [m/s^2].
        covariance: shape (27, 27), of the error in the order of the module's places.
        innovations: shape (18,) of the last correction: position and rotation of the left sole by its leg, of the right
            one, then height and normal (2) of each sole that stood.
        rows: shape (18, 27) of these.
    """

    def __init__(self, noise: FilterNoise | None = None) -> None:
        """``noise``: of sensors and soles; that of :class:`FilterNoise` if not given."""
        self.noise = noise or FilterNoise()
        self.rotation, self.velocity, self.position = np.eye(3), np.zeros(3), np.zeros(3)
        self.sole_positions, self.sole_rotations = np.zeros((2, 3)), np.stack([np.eye(3)] * 2)
        self.gyro_bias, self.accelerometer_bias = np.zeros(3), np.zeros(3)
        self.covariance = np.eye(SIZE)
        self._error, self._density = np.zeros(SIZE), self._fixed_densities()
        self.rows, self.innovations, self._variance = np.zeros((18, SIZE)), np.zeros(18), self._variances()
        for foot in range(2):
            for row in range(3):
                # innovations of the legs: xi_p - xi_d, and xi_R - xi_R_i
                self.rows[6 * foot + row, [POSITION.start + row, sole_position(foot).start + row]] = 1.0, -1.0
                self.rows[6 * foot + 3 + row, [ROTATION.start + row, sole_rotation(foot).start + row]] = 1.0, -1.0

    def _fixed_densities(self) -> Array:
        noise, out = self.noise, np.zeros(SIZE)
        out[VELOCITY] = noise.accelerometer**2
        out[GYRO_BIAS], out[ACCELEROMETER_BIAS] = noise.gyro_drift**2, noise.accelerometer_drift**2
        return out

    def _variances(self) -> Array:
        """Of the innovations: both legs', and those of two soles on the ground."""
        noise = self.noise
        legs = [noise.kinematics**2] * 3 + [noise.kinematics_rotation**2] * 3
        ground = [noise.ground**2] + [noise.level**2] * 2
        return np.array(2 * legs + 2 * ground)

    def reset(self, rotation: Array, position: Array, soles: Array, sole_rotations: Array, gyro_bias: Array) -> None:
        """Start at rest.

        Args:
            rotation: shape (3, 3) of the IMU.
            position: shape (3,) of the IMU [m].
            soles: shape (2, 3) [m].
            sole_rotations: shape (2, 3, 3).
            gyro_bias: shape (3,), as measured at rest [rad/s].
        """
        self.rotation, self.position, self.velocity = rotation.copy(), position.copy(), np.zeros(3)
        self.sole_positions, self.sole_rotations = soles.copy(), sole_rotations.copy()
        self.gyro_bias, self.accelerometer_bias = gyro_bias.copy(), np.zeros(3)
        noise, deviation = self.noise, np.zeros(SIZE)
        # where it is and which way it looks is where the world begins
        deviation[VELOCITY], deviation[POSITION] = 1e-3, 1e-4
        deviation[GYRO_BIAS], deviation[ACCELEROMETER_BIAS] = noise.start_gyro_bias, noise.start_accelerometer_bias
        tilt = np.zeros((SIZE, 3))
        tilt[ROTATION], tilt[POSITION] = np.eye(3), skew(self.position)
        for foot in range(2):
            deviation[sole_position(foot)], deviation[sole_rotation(foot)] = noise.kinematics, noise.kinematics_rotation
            # the soles are where the legs have them: what the base is tilted by, they are too
            tilt[sole_position(foot)], tilt[sole_rotation(foot)] = skew(self.position), np.eye(3)
        spread = np.array([noise.start_tilt, noise.start_tilt, 1e-6]) ** 2
        self.covariance = np.diag(deviation**2) + tilt * spread @ tilt.T

    def predict(self, gyro: Array, accelerometer: Array, standing: Array, dt: float) -> None:
        """Go on by ``dt`` [s].

        Args:
            gyro: shape (3,) measured rate in the IMU's axes [rad/s].
            accelerometer: shape (3,) measured specific force, likewise [m/s^2].
            standing: shape (2,) how certain it is that each foot stands, 0 to 1.
            dt: since the last one [s].
        """
        predict_covariance(
            self.covariance,
            self.rotation,
            self.velocity,
            self.position,
            self.sole_positions,
            self._densities(standing),
            self.noise.gyro**2,
            GRAVITY,
            dt,
        )
        rate, force = gyro - self.gyro_bias, accelerometer - self.accelerometer_bias
        acceleration = self.rotation @ exponential(0.5 * dt * rate) @ force + DOWN
        self.position += dt * self.velocity + 0.5 * dt * dt * acceleration
        self.velocity += dt * acceleration
        self.rotation = self.rotation @ exponential(dt * rate)

    def _densities(self, standing: Array) -> Array:
        """Densities (27,), squared, of the noise of each entry of the error; the gyro's is not among them."""
        noise, out = self.noise, self._density
        for foot in range(2):
            # from one to the other evenly on a logarithmic scale: a foot that half stands is neither
            on, off = float(standing[foot]), 1.0 - float(standing[foot])
            out[sole_position(foot)] = (noise.slip**on * noise.swing**off) ** 2
            out[sole_rotation(foot)] = (noise.twist**on * noise.swing**off) ** 2
        return out

    def correct(self, soles: Array, sole_rotations: Array, standing: Mask, ground: Array | None = None) -> None:
        """Take in what the legs say of the soles, and that those that stand are on the ground and level.

        Args:
            soles: shape (2, 3) positions in the IMU's axes, from the joints [m].
            sole_rotations: shape (2, 3, 3) in the IMU's axes, likewise.
            standing: shape (2,) which feet stand on level ground.
            ground: shape (2,) height of the ground under each [m]; ``None`` where nothing is known of it.
        """
        count, H, residual = 12, self.rows, self.innovations
        for foot in range(2):
            place = slice(6 * foot, 6 * foot + 3), slice(6 * foot + 3, 6 * foot + 6)
            residual[place[0]] = self.rotation @ soles[foot] - (self.sole_positions[foot] - self.position)
            residual[place[1]] = logarithm(self.rotation @ sole_rotations[foot] @ self.sole_rotations[foot].T)
        for foot in range(2):
            if ground is not None and standing[foot]:
                self._stand_on(foot, float(ground[foot]), count)
                count += 3
        correct_covariance(self.covariance, H[:count], residual[:count], self._variance[:count], self._error)
        np.negative(self._error, out=self._error)
        self.retract(self._error)

    def doubt_gyro_bias(self, deviation: float) -> None:
        """Take the gyro's bias to be wrong by ``deviation`` [rad/s] more than it was thought to be."""
        for i in range(GYRO_BIAS.start, GYRO_BIAS.stop):
            self.covariance[i, i] += deviation**2

    def _stand_on(self, foot: int, ground: float, first: int) -> None:
        r"""Write three rows from ``first`` on: a sole is at the height ``ground`` [m], and level.

        .. math:: \hat d_z - d_z = (\xi_R \times d)_z + \xi_{d,z}, \qquad
            (\hat R_i e_z)_{xy} = (\xi_{R_i} \times e_z)_{xy}
        """
        H, d, place = self.rows[first : first + 3], self.sole_positions[foot], sole_rotation(foot).start
        H[:] = 0.0
        H[0, ROTATION] = d[1], -d[0], 0.0
        H[0, sole_position(foot).start + 2] = 1.0
        H[1, place + 1], H[2, place] = 1.0, -1.0
        self.innovations[first] = d[2] - ground
        self.innovations[first + 1 : first + 3] = self.sole_rotations[foot][:2, 2]

    def retract(self, error: Array) -> None:
        r"""Move the estimate by an error (27,): :math:`\exp(\xi)` from the left, biases by addition."""
        turn, push = exponential(error[ROTATION]), left_jacobian(error[ROTATION])
        self.rotation = turn @ self.rotation
        self.velocity = turn @ self.velocity + push @ error[VELOCITY]
        self.position = turn @ self.position + push @ error[POSITION]
        for foot in range(2):
            self.sole_positions[foot] = turn @ self.sole_positions[foot] + push @ error[sole_position(foot)]
            self.sole_rotations[foot] = exponential(error[sole_rotation(foot)]) @ self.sole_rotations[foot]
        self.gyro_bias = self.gyro_bias + error[GYRO_BIAS]
        self.accelerometer_bias = self.accelerometer_bias + error[ACCELEROMETER_BIAS]
