"""The dynamic level of a tick: from a filtered velocity to the problem of DynWBC, and to the motors' torques."""

import numpy as np

from controllers.reference import WholeBodyReference
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.feedforward import gravity_torque
from controllers.whole_body.mass_estimator import MassEstimator
from controllers.whole_body.strategy import AccelerationConditions
from robots.description import Sole
from robots.kinematics import Kinematics
from robots.messages import Array, Mask, RobotState
from wbc.contact import SoleContact
from wbc.dynwbc import DynWbc, DynWbcResult, contact_bias_acceleration
from wbc.torque_qp import DynWbcProblem
from wbc.wrench import reference_wrenches


class DynamicLevel:
    """DynWBC and what it is asked for.

    Attributes:
        dynwbc: the torque QP.
        load: how heavy the robot really is; ``None`` where the model's mass is taken.
        half_sizes: shape (2, 2) half length and half width of each sole that the pressure may use [m].
    """

    def __init__(self, kin: Kinematics, config: ControllerConfig) -> None:
        """For one robot.

        Raises:
            ConfigError: unknown solver.
        """
        self._kin, self._dt, self._torque = kin, config.dt, config.torque
        self._mass = kin.robot.total_mass
        mass_time_constant = config.balance.mass_time_constant
        self.load = MassEstimator(self._mass, mass_time_constant) if mass_time_constant > 0 else None
        contacts = [_contact(config, sole) for sole in kin.robot.soles]
        self.half_sizes = np.array([[c.half_length, c.half_width] for c in contacts])
        self.dynwbc = DynWbc(kin, contacts, config.dynwbc, config.dynwbc_solver)
        self._soles = np.array(self.dynwbc.frame_ids)

    def problem(
        self,
        state: RobotState,
        reference: WholeBodyReference,
        v_safe: Array,
        conditions: AccelerationConditions | None,
    ) -> DynWbcProblem:
        """DynWBC's problem for a filtered velocity (nv,) and what its acceleration has to satisfy."""
        kin, dynwbc = self._kin, self.dynwbc
        acceleration = dynwbc.acceleration_reference(v_safe, state.v, self._dt)
        load_scale = self._estimate_load(state)
        wrench = self._wrench_reference(reference, acceleration, load_scale)
        contact_bias = None
        if dynwbc.weights.contact > 0:
            contact_bias = contact_bias_acceleration(kin, dynwbc.frame_ids)
        rows, bounds = None, None
        if conditions is not None:
            rows, bounds = (conditions.spaces.A, conditions.spaces.b), conditions.joint_bounds
        contact, limits = reference.in_contact, reference.load_limits
        return dynwbc.build(kin, acceleration, wrench, contact, contact_bias, rows, bounds, load_scale, limits)

    def feed_forward(self, dynamic: DynWbcResult, in_contact: Mask) -> Array:
        """Torques (nj,) that the motors are told, as the configuration has it."""
        if self._torque == "full":
            return dynamic.torque.copy()
        if self._torque == "pd-only":
            return np.zeros(dynamic.torque.size)
        jacobian = self.dynwbc.contact_jacobian(self._kin, in_contact)
        return gravity_torque(self._kin, jacobian, self.half_sizes[in_contact])

    def _estimate_load(self, state: RobotState) -> float:
        if self.load is None:
            return 1.0
        if state.foot_forces is None:
            return self.load.scale
        return self.load.update(state.foot_forces, self._dt)

    def _wrench_reference(self, reference: WholeBodyReference, command: Array, load_scale: float) -> Array:
        """Wrenches (12,) that give the CoM the acceleration that an acceleration command (nv,) asks of it.

        The command holds the feedback of the CoM task. Taken after the filter, so that the forces do not push the
        robot back into what the filter has just steered it out of.
        """
        kin = self._kin
        return reference_wrenches(
            load_scale * self._mass,
            kin.com,
            kin.com_jacobian,
            command,
            kin.frame_transforms,
            self._soles,
            reference.in_contact,
            reference.load_limits,
            self.half_sizes,
        )


def _contact(config: ControllerConfig, sole: Sole) -> SoleContact:
    """What the controller assumes of a sole."""
    c = config.contact
    return SoleContact(sole.frame, c.length_fraction * sole.half_length, c.width_fraction * sole.half_width, c.friction)
