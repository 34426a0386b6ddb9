"""One tick of the stack: state in, motor command out."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from controllers.reference import WholeBodyReference
from controllers.whole_body.acceleration_filter import AccelerationFilter
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.feedforward import gravity_torque
from controllers.whole_body.mass_estimator import LoadEstimator
from controllers.whole_body.task_stack import TaskStack
from controllers.whole_body.warm_up import situations
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, Mask, MotorCommand, RobotState
from safety.barriers.barrier_set import Barrier, BarrierSet, ObstacleBarrier, standard_barriers
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.adaptation import EpsilonAdapter
from safety.filters.safety_filter import FilterResult, FilterStatus, SafetyFilter
from safety.geometry.shapes import Obstacle
from wbc.contact import SoleContact
from wbc.dynwbc import DynWbc, DynWbcResult, contact_bias_acceleration
from wbc.torque_qp import DynWbcProblem
from wbc.wrench import reference_wrenches

STAGES = ("kinematics", "tasks", "kinwbc", "rows", "safety_qp", "dynamics", "dynwbc")
"""Stages of a tick, in order; ``dynamics`` is the assembly of DynWBC's problem, ``dynwbc`` its solution."""


@dataclass(frozen=True, slots=True)
class TickResult:
    """What one tick decided.

    Attributes:
        command: for the motors.
        v_des: shape (nv,) velocity of KinWBC.
        safety: result of the safety filter.
        dynwbc: result of DynWBC.
        stage_seconds: shape (len(STAGES),) time spent in each stage [s].
    """

    command: MotorCommand
    v_des: Array
    safety: FilterResult
    dynwbc: DynWbcResult
    stage_seconds: Array


class WholeBodyController:
    """KinWBC, safety filter and DynWBC for one robot, on its nominal model.

    Args:
        robot: the description.
        config: settings.
        with_hands: whether the hands are tasks (then every reference must give them).
        obstacle_kinds: kind of each obstacle that every tick is given (see :mod:`safety.geometry.shapes`).
        clock: monotonic seconds, for the stage times.
        extra_barriers: makes further barriers from the controller's kinematics. An
            :class:`safety.barriers.barrier_set.ObstacleBarrier` among them, of chosen bodies say, is told the obstacles
            of every tick where ``obstacle_kinds`` are none.

    Raises:
        ConfigError: a setting is not allowed.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: ControllerConfig,
        with_hands: bool,
        obstacle_kinds: Sequence[str] = (),
        clock: Callable[[], float] = time.perf_counter,
        extra_barriers: Callable[[Kinematics], Sequence[Barrier]] | None = None,
    ) -> None:
        self.robot = robot
        self.config = config
        self.with_hands = with_hands
        self._kinematics_time = 0.0
        self._make_twin = partial(
            WholeBodyController, robot, config, with_hands, tuple(obstacle_kinds), extra_barriers=extra_barriers
        )
        self.kin = Kinematics(robot)
        self._clock = clock
        self._mass = robot.total_mass
        load_time = config.balance.load_time
        self.load = LoadEstimator(self._mass, load_time) if load_time > 0 else None
        extra = () if extra_barriers is None else extra_barriers(self.kin)
        self.barriers: BarrierSet = standard_barriers(self.kin, obstacle_kinds, extra)
        self._obstacles = next((b for b in self.barriers.barriers if isinstance(b, ObstacleBarrier)), None)
        safety = config.safety
        v_max = safety.velocity_scale * robot.joint_array("velocity")
        v_max = np.concatenate([[safety.base_linear] * 3, [safety.base_angular] * 3, v_max])
        self.acceleration_filter = AccelerationFilter(safety.parameters(), v_max) if config.filter == "ecbf" else None
        self.filter = SafetyFilter(
            "none" if self.acceleration_filter else config.filter,
            self.barriers.size,
            safety.parameters(),
            v_max,
            safety.foot_weight,
            safety.balance_weight,
            safety.hand_weight,
            config.infeasible,
            dt=config.dt,
            recovery=safety.recovery(),
        )
        self.adapter = EpsilonAdapter(safety.parameters(), config.adaptation, config.dt) if config.adaptive else None
        contacts = [self._contact(s.frame, s.half_length, s.half_width) for s in robot.soles]
        count = self.barriers.size if self.acceleration_filter else 0
        self.dynwbc = DynWbc(self.kin, contacts, config.dynwbc, config.dynwbc_solver, count)
        self._soles = np.array(self.dynwbc.frame_ids)
        self._half_sizes = np.array([[c.half_length, c.half_width] for c in contacts])
        # as the weight of a foot on the ground goes with the square of its rows
        self._swing_share = math.sqrt(safety.swing_weight / safety.foot_weight) if safety.foot_weight > 0 else 0.0
        self._tasks = TaskStack(self.kin, config, with_hands, self._half_sizes)
        self.kinwbc = self._tasks.kinwbc
        self._kp = config.gain_scale * robot.joint_array("kp")
        self._kd = config.gain_scale * robot.joint_array("kd")
        for gains in (self._kp, self._kd):
            # every command hands them out
            gains.setflags(write=False)

    def _contact(self, frame: str, half_length: float, half_width: float) -> SoleContact:
        c = self.config.contact
        return SoleContact(frame, c.length_share * half_length, c.width_share * half_width, c.friction)

    def warm_up(self) -> None:
        """Have everything ready that the first tick would wait for: kernels compiled or loaded, libraries started.

        A twin made of the same arguments ticks through the situations of :mod:`controllers.whole_body.warm_up` and is
        thrown away. So this controller stays as it is, whenever this is called, and its answers do not change by a bit;
        only ``extra_barriers`` is called once more. Takes some 0.2 s, where the kernels have to be compiled some 20 s.
        """
        twin = self._make_twin()
        kinds = () if twin._obstacles is None else twin._obstacles.kinds
        for state, reference, obstacles in situations(twin.kin, self.with_hands, kinds):
            twin.tick(state, reference, obstacles)
        self.filter.prepare(twin.barriers.evaluate(twin.kin).family)

    def reset(self, state: RobotState) -> None:
        """Start from a state at rest: the torques measured there are the first tau_prev."""
        self.kin.update(state.q, state.v)
        self.kinwbc.reset()
        self.dynwbc.reset(state.tau)
        self.filter.reset()
        if self.adapter is not None:
            self.adapter.reset()

    def desired_velocity(self, reference: WholeBodyReference) -> Array:
        """KinWBC alone: velocity (nv,) for a reference at the configuration of ``kin``."""
        if self.config.without_drift:
            self.kin.update_drift()
        self._tasks.set_references(reference)
        return self.kinwbc.solve(self.kinwbc.evaluate(self.kin))

    def tick(self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()) -> TickResult:
        """Compute the motor command for one measured state.

        Args:
            state: measured or estimated.
            reference: what to do now.
            obstacles: of the kinds announced.

        Returns:
            The command and what led to it.

        Raises:
            ValueError: the state is not finite (a supervisor stops before that, see
                :class:`controllers.supervisor.Supervisor`), number or kinds of obstacles are not as announced, or the
                reference gives no hands to a controller that has them as tasks.
        """
        if not all_finite(state.q, state.v):
            raise ValueError("measured state is not finite")
        self.update(state)
        return self.respond(state, reference, obstacles)

    def update(self, state: RobotState) -> None:
        """Bring ``kin`` up to a measured state, for :meth:`respond` and for whoever moves the references before it."""
        began = self._clock()
        self.kin.update(state.q, state.v)
        if self.config.without_drift:
            self.kin.update_drift()
        self._kinematics_time = self._clock() - began

    def respond(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> TickResult:
        """:meth:`tick` for the state of the last :meth:`update`."""
        kin, dt, clock, marks = self.kin, self.config.dt, self._clock, np.empty(len(STAGES) + 1)
        marks[1] = clock()
        marks[0] = marks[1] - self._kinematics_time
        self._tasks.set_references(reference)
        levels = self.kinwbc.evaluate(kin)
        marks[2] = clock()
        v_des = self.kinwbc.solve(levels)
        marks[3] = clock()
        rows = self._barrier_rows(obstacles)
        marks[4] = clock()
        safety = self._filter_velocity(rows, v_des, levels, reference.in_contact, state.v)
        marks[5] = clock()
        problem, spaces = self._dynamic_problem(state, reference, rows, safety.v)
        marks[6] = clock()
        dynamic = self.dynwbc.solve(problem)
        if self.acceleration_filter is not None and spaces is not None:
            safety = self.acceleration_filter.result(self.dynwbc, spaces, dynamic, state.v, dt)
        marks[7] = clock()
        command = self._command(state, safety.v, self._feed_forward(dynamic, reference.in_contact))
        return TickResult(command, v_des, safety, dynamic, marks[1:] - marks[:-1])

    def _dynamic_problem(
        self, state: RobotState, reference: WholeBodyReference, rows: BarrierRows, v_safe: Array
    ) -> tuple[DynWbcProblem, HalfSpaces | None]:
        """DynWBC's problem for a filtered velocity (nv,), and the conditions in it where accelerations are filtered."""
        kin, dt = self.kin, self.config.dt
        acceleration = self.dynwbc.acceleration_reference(v_safe, state.v, dt)
        load_scale = self._estimate_load(state)
        wrench = self._wrench_reference(reference, acceleration, load_scale)
        contact_bias = None
        if self.config.dynwbc.contact > 0:
            contact_bias = contact_bias_acceleration(kin, self.dynwbc.frame_ids)
        spaces, conditions, bounds = None, None, None
        if self.acceleration_filter is not None:
            spaces = self.acceleration_filter.conditions(rows, state.v)
            conditions = (spaces.A, spaces.b)
            bounds = self.acceleration_filter.joint_bounds(self.dynwbc, state.v, dt)
        contact, limits = reference.in_contact, reference.load_limits
        problem = self.dynwbc.build(
            kin, acceleration, wrench, contact, contact_bias, conditions, bounds, load_scale, limits
        )
        return problem, spaces

    def _command(self, state: RobotState, v_safe: Array, torque: Array) -> MotorCommand:
        q = state.q[7:] + v_safe[6:] * self.config.dt
        return MotorCommand(q, v_safe[6:].copy(), torque, self._kp, self._kd, state.stamp)

    def _feed_forward(self, dynamic: DynWbcResult, in_contact: Mask) -> Array:
        """Torques (nj,) that the motors are told, as the configuration has it."""
        if self.config.torque == "full":
            return dynamic.torque.copy()
        if self.config.torque == "pd-only":
            return np.zeros(dynamic.torque.size)
        jacobian = self.dynwbc.contact_jacobian(self.kin, in_contact)
        return gravity_torque(self.kin, jacobian, self._half_sizes[in_contact])

    def _estimate_load(self, state: RobotState) -> float:
        if self.load is None:
            return 1.0
        if state.foot_forces is None:
            return self.load.scale
        return self.load.update(state.foot_forces, self.config.dt)

    def _barrier_rows(self, obstacles: Sequence[Obstacle]) -> BarrierRows:
        """Rows at the kinematics' state, of second order where accelerations are filtered."""
        if self._obstacles is not None:
            self._obstacles.set_obstacles(obstacles)
        elif obstacles:
            raise ValueError(f"{len(obstacles)} obstacles given, 0 announced")
        second_order = self.acceleration_filter is not None
        if second_order:
            self.kin.update_second_order()
        return self.barriers.evaluate(self.kin, second_order)

    def _filter_velocity(
        self,
        rows: BarrierRows,
        v_des: Array,
        levels: Sequence[tuple[Array, Array]],
        in_contact: Mask,
        velocity: Array,
    ) -> FilterResult:
        if self.acceleration_filter is not None:
            return FilterResult(self.acceleration_filter.velocity(v_des), FilterStatus.UNCHANGED, 0.0, -1, 0)
        feet = self._stance_jacobian(levels[0][0], in_contact)
        balance = self.kinwbc.rows(1, 4)
        hands = levels[4][0] if self.with_hands else None
        if self.adapter is None:
            return self.filter.apply(rows, v_des, feet, balance, hands)
        epsilon = self.adapter.epsilon(rows, velocity)
        result = self.filter.apply(rows, v_des, feet, balance, hands, epsilon=epsilon)
        self.adapter.told(result.v)
        return result

    def _stance_jacobian(self, feet: Array, in_contact: Mask) -> Array:
        """Rows of the feet's Jacobians (12, nv) that the filter is to leave alone.

        All of a foot on the ground. Of a foot in the air its orientation: turned by its ankle out of another leg's way,
        it would come down on its edge. Its position by a weight of its own.
        """
        left, right = in_contact.tolist()
        if left and right:
            return feet
        kept = feet.copy()
        for foot, standing in enumerate(in_contact):
            if not standing:
                kept[6 * foot : 6 * foot + 3] *= self._swing_share
        return kept

    def _wrench_reference(self, reference: WholeBodyReference, command: Array, load_scale: float) -> Array:
        """Wrenches (12,) that give the CoM the acceleration that an acceleration command (nv,) asks of it.

        The command holds the feedback of the CoM task. Taken after the filter, so that the forces do not push the
        robot back into what the filter has just steered it out of.
        """
        kin = self.kin
        return reference_wrenches(
            load_scale * self._mass,
            kin.com,
            kin.com_jacobian,
            command,
            kin.frame_transforms,
            self._soles,
            reference.in_contact,
            reference.load_limits,
            self._half_sizes,
        )
