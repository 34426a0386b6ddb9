r"""Forces under the feet from the torques of the legs, the legs' own motion accounted for.

The generalised momentum :math:`p = M(q) v` obeys :math:`\dot p = S^T \tau + C^T v - g + J^T w` with the forces w from
outside, in which no acceleration appears. The observer

.. math:: r = K \left(p - \int (S^T \tau + C^T v - g + r)\, dt\right), \qquad \dot r = K (J^T w - r)

follows :math:`J^T w` with a first-order lag of 1/K. Source: De Luca, Albu-Schäffer, Haddadin and Hirzinger, *Collision
detection and safe reaction with the DLR-III lightweight manipulator arm*, IROS 2006, eqs. (9), (10). The wrench on a
sole is read from the rows of its own leg alone, :math:`J_{leg}^T w = r_{leg}`: what the trunk really weighs, and who
pushes it, does not matter there.
"""

import numpy as np
import pinocchio as pin

from robots.checks import require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, Indices

DAMPING = 2e-6
"""Of the least squares in a leg's six equations, times the sum of its squared singular values: those of a leg that is
nearly straight lose by it."""

EYE = np.eye(6)

SLIDES = 0.05
"""Rate at which a joint's dry friction counts fully [rad/s]: below, it may act either way, up to that."""


class MomentumObserver:
    """Wrenches on both soles; see the module.

    Attributes:
        residual: r, shape (nv,) [N, N m].
        sole_velocities: shape (2, 6) of the last update: linear [m/s], then angular [rad/s], sole axes.
    """

    def __init__(self, robot: RobotDescription, bandwidth: float) -> None:
        """For ``robot``, which follows with ``bandwidth`` K, above 0 [1/s].

        Raises:
            ConfigError: the bandwidth is not above 0, or a leg has not six joints.
        """
        require_positive("bandwidth of the momentum observer", bandwidth)
        self._kin = Kinematics(robot)
        self._gain = bandwidth
        self._soles = [self._kin.frame_id(sole.frame) for sole in robot.soles]
        self._legs = [leg_columns(self._kin, sole) for sole in self._soles]
        self._leg_table, self._jacobians = np.array(self._legs), np.zeros((2, 6, 6))
        self.sole_velocities = np.zeros((2, 6))
        self.residual, self._integral = np.zeros(self._kin.nv), np.zeros(self._kin.nv)
        self._damping, self._dry = robot.joint_array("damping"), robot.joint_array("friction_loss")
        self._begun = False

    def reset(self) -> None:
        """Begin anew: with the next state the forces are those of rest."""
        self._begun = False

    def update(self, q: Array, v: Array, torque: Array, dt: float) -> Array:
        """Take in a state and the torques that led to it.

        Args:
            q: shape (nq,), of the floating base.
            v: shape (nv,).
            torque: shape (nj,) of the motors over the last ``dt`` [N m].
            dt: since the last one [s].

        Returns:
            Wrenches (2, 6) on the soles: force, then moment about the sole's frame, sole axes [N, N m].
        """
        kin = self._kin
        kin.update(q, v)
        coriolis = pin.computeCoriolisMatrix(kin.model, kin.data, kin.q, kin.v)
        momentum = kin.mass_matrix @ v
        # C^T v - g, with g = (C v + g) - C v
        push = v @ coriolis + coriolis @ v - kin.bias
        push[6:] += torque - self._damping * v[6:] - self._dry * np.tanh(v[6:] / SLIDES)
        if not self._begun:
            # at rest nothing changes: what is not held by the motors is held from outside
            self.residual, self._begun = -push, True
            self._integral = momentum - self.residual / self._gain
        else:
            self._integral += dt * (push + self.residual)
            self.residual = self._gain * (momentum - self._integral)
        return self._wrenches(v)

    def _wrenches(self, v: Array) -> Array:
        """Least squares of both legs at once; and how fast the soles move."""
        for foot, sole in enumerate(self._soles):
            jacobian = self._kin.frame_jacobian(sole, local=True)
            self._jacobians[foot] = jacobian[:, self._legs[foot]]
            np.matmul(jacobian, v, out=self.sole_velocities[foot])
        square = self._jacobians @ self._jacobians.transpose(0, 2, 1)
        square += DAMPING * np.einsum("fii->f", square)[:, None, None] * EYE
        right = self._jacobians @ self.residual[self._leg_table][:, :, None]
        return np.asarray(np.linalg.solve(square, right)[:, :, 0])


def leg_columns(kin: Kinematics, sole: int) -> Indices:
    """Places (6,) in the velocity of the joints between base and a sole's frame.

    Raises:
        ConfigError: there are not six.
    """
    columns = np.flatnonzero(kin.support[kin.frame_joint(sole)])
    legs = columns[columns >= kin.nv_base]
    if legs.size != 6:
        raise ConfigError("joints of a leg", legs.size, "6, so that its torques tell the wrench on its sole")
    return legs
