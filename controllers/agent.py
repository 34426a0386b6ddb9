"""What runs on the robot: measured state and detections in, motor command out, one call a tick."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from controllers.gaits.gait import Gait
from controllers.motions.hands import CenterOfMassShift, Motion
from controllers.perception import Detection, ObstacleSlots
from controllers.reference import PointReference, WholeBodyReference, reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.task_stack import PlacedTask
from robots.checks import all_finite, require_non_negative
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, MotorCommand, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier import Barrier
from safety.filters.results import FilterStatus
from safety.geometry.shapes import Obstacle

if TYPE_CHECKING:
    from controllers.obstacle_tracker import ObstacleTracker, TrackingSettings

LOGGER = logging.getLogger(__name__)

HANDS = ("left hand", "right hand")

STILL = np.zeros(3)
STILL.setflags(write=False)

MakeMotion = Callable[[RobotDescription, WholeBodyReference], Motion]
"""Makes a motion from the robot and the references at the start."""

MakeGait = Callable[[Kinematics], Gait]
"""Makes a gait from the kinematics at the start, both feet on the ground."""


@dataclass(frozen=True, slots=True)
class AgentOutput:
    """What one tick of an agent came to.

    Attributes:
        command: for the motors.
        result: the controller's; ``None`` once the motors fade out.
        reference: what was asked for, the agent's own: the next tick changes it.
        obstacles: what the controller was told, in the order of its slots.
    """

    command: MotorCommand
    result: TickResult | None
    reference: WholeBodyReference
    obstacles: Sequence[Obstacle]


class Agent:
    """Controller, supervisor, obstacle tracks, gait, motions and references of one robot behind one call a tick.

    What happens on a stop is here and not with whoever calls. Two ways to stop, both for good, both with the first
    cause kept:

    - *Hold* (:meth:`hold`), where the state is sound but the task cannot go on: an obstacle's track is too old, or
      nothing could keep the robot away from it; a reference is no number; a motion, gait or sensor raises an error,
      which is logged; or somebody asks for it. A gait is stopped and brings the robot to rest on both feet;
      without one the references freeze. Hands stay where they are asked to be. The controller goes on keeping balance,
      among the obstacles last known, at rest.
    - *Fade-out*, where the state or the controller cannot be trusted: see :class:`controllers.supervisor.Supervisor`.

    Between ticks anything may change: ``motions`` (a list), the gait's command, obstacles that are detected for the
    first time or :meth:`forgotten <forget>`, the controller's filter and parameters.

    Args:
        robot: the description.
        config: of the controller; that of the description if not given.
        gait: makes what moves feet and balance; without one the robot stands on both feet.
        motions: each makes what moves other parts of the references.
        with_hands: whether the hands are tasks.
        obstacle_slots: kinds of the obstacles that the controller can keep away from at a time; where there are more of
            a kind, the nearest count.
        tracking: how detections become obstacles, all of them or each by its name.
        settle_time: over which the CoM goes from where the robot stands to over the middle of the feet, without a gait;
            0 for at once [s].
        extra_barriers: see :class:`controllers.whole_body.controller.WholeBodyController`.
        extra_tasks: likewise.
        clock: monotonic seconds, for the stage times.

    Attributes:
        controller: the whole-body controller.
        supervisor: of the controller.
        reference: of all tasks; after :meth:`reset`.
        gait: as made; ``None`` for none.
        motions: applied in their order, after the gait.
        refused: number of detections that came too late, or with a stamp that is none.
        known: obstacles that need no sensor, by name: where they are now, to be kept up to date from outside.

    Raises:
        ConfigError: a setting is not allowed.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: ControllerConfig | None = None,
        *,
        gait: MakeGait | None = None,
        motions: Sequence[MakeMotion] = (),
        with_hands: bool = False,
        obstacle_slots: Sequence[str] = (),
        tracking: "TrackingSettings | Mapping[str, TrackingSettings] | None" = None,
        settle_time: float = 1.5,
        extra_barriers: Callable[[Kinematics], Sequence[Barrier]] | None = None,
        extra_tasks: Callable[[Kinematics], Sequence[PlacedTask]] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        require_non_negative("settle_time", settle_time)
        self.robot, self._settle_time = robot, settle_time
        self.controller = WholeBodyController(
            robot, config or controller_config(robot), with_hands, obstacle_slots, clock, extra_barriers, extra_tasks
        )
        self._make_gait, self._make_motions = gait, tuple(motions)
        self._tracking, self._slots = tracking, ObstacleSlots(obstacle_slots)
        self.gait: Gait | None = None
        self.motions: list[Motion] = []
        self.known: Mapping[str, Obstacle] = {}
        self.refused = 0
        self._begun, self._start_time, self._stamp = False, 0.0, 0.0
        self.controller.kin.update_geometry(standing_configuration(robot))
        self.reference = reference_here(self.controller.kin, with_hands)
        self._forget_everything()

    def _forget_everything(self) -> None:
        self.supervisor = Supervisor(self.controller)
        self.tracker = self._make_tracker()
        self._obstacles: Sequence[Obstacle] = self._slots.fill({}, np.zeros(3))
        self._frozen: WholeBodyReference | None = None
        self._keep_hands()

    def _make_tracker(self) -> "ObstacleTracker | None":
        if not self._slots.kinds:
            return None
        # here, because the tracks' filter brings scipy.stats with it, which a robot without obstacles need not wait for
        from controllers.obstacle_tracker import ObstacleTracker  # noqa: PLC0415

        return ObstacleTracker(self._tracking)

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return self.controller.config.dt

    @property
    def stop_cause(self) -> str | None:
        """Why the robot was stopped; ``None`` while it runs."""
        return self.supervisor.cause

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of obstacles that found no slot in the last tick."""
        return self._slots.left_out

    def warm_up(self) -> None:
        """Have everything ready that the first tick would wait for; see :meth:`WholeBodyController.warm_up`."""
        self.controller.warm_up()

    def reset(self, state: RobotState, start: Array | None = None) -> None:
        """Start from a state at rest on both feet: references where the robot is, new gait and motions, no stop.

        Args:
            state: measured. Its stamp is time zero of gait and motions.
            start: shape (nq,) configuration from which the references begin, where that is known better than it is
                measured: a named posture that the robot was put in. That of ``state`` if not given.
        """
        self._begun, self._start_time, self._stamp = True, state.stamp, state.stamp
        controller, kin = self.controller, self.controller.kin
        begin = state if start is None else replace(state, q=start, v=np.zeros(kin.nv))
        kin.update(begin.q, begin.v)
        self.reference = reference_here(kin, with_hands=controller.with_hands)
        self._forget_everything()
        self.gait = None if self._make_gait is None else self._make_gait(kin)
        self.motions = []
        if self.gait is None and self._settle_time > 0.0:
            self.motions.append(CenterOfMassShift(kin.com.copy(), self.reference.com.position, self._settle_time))
        self.motions += [make(self.robot, self.reference) for make in self._make_motions]
        controller.reset(state)

    def tick(self, state: RobotState, detections: Sequence[Detection] = ()) -> AgentOutput:
        """The command for a measured state.

        Args:
            state: measured or estimated.
            detections: what sensors saw since the last tick.

        Returns:
            The command and what led to it; a command in every tick, whatever is wrong.
        """
        sound = self.supervisor.inspect(state)
        if sound and not self._begun:
            self._begin(state)
        self._stamp = state.stamp
        if sound:
            self.controller.update(state)
            self._guard("references", partial(self._move_references, state))
            self._guard("obstacles", partial(self._observe, detections, state.stamp))
        reference = self._asked_for()
        command, result = self.supervisor.respond(state, reference, self._obstacles)
        if result is not None and result.safety.status == FilterStatus.FAILED and not all_finite(result.v_des):
            self._refuse_references()
        return AgentOutput(command, result, reference, self._obstacles)

    def _begin(self, state: RobotState) -> None:
        """Start where nobody has; a stop that was asked for before stays."""
        asked = self.supervisor.cause
        self.reset(state)
        if asked is not None:
            self.supervisor.latch(asked, state.stamp)

    def _guard(self, what: str, step: Callable[[], None]) -> None:
        """Hold the robot where somebody's motion, gait or sensor raises: the motors get a command all the same."""
        try:
            step()
        except Exception as error:
            if self.supervisor.cause is None:
                LOGGER.exception("%s: the robot is held", what)
            self.supervisor.latch(f"{what}: {type(error).__name__}: {error}", self._stamp)

    def _refuse_references(self) -> None:
        """Hold a robot that was asked for what is no number; without a gait where it stands."""
        self.supervisor.latch("the references are not finite", self._stamp)
        if self.gait is None:
            self._frozen = reference_here(self.controller.kin, self.controller.with_hands)

    def references_at(self, state: RobotState) -> WholeBodyReference:
        """What would be asked for at a sound state, without a command: the motion that gait and motions have in mind.

        The references are the agent's own, and moved on as :meth:`tick` moves them.
        """
        self.controller.update(state)
        self._move_references(state)
        return self._asked_for()

    def hold(self, cause: str) -> None:
        """Stop the task for ``cause`` from the next tick on, and keep balance; the first cause stays."""
        self.supervisor.latch(cause, self._stamp)

    def forget(self, name: str) -> None:
        """The obstacle of this name is gone."""
        if self.tracker is not None:
            self.tracker.forget(name)

    # -- obstacles

    def _observe(self, detections: Sequence[Detection], stamp: float) -> None:
        """Bring the tracks up to ``stamp`` [s]; one that is too old holds the robot, among what was known last.

        So does an obstacle of a kind that there is no slot for at all: nothing would keep the robot away from it.
        """
        if self.tracker is None:
            if detections or self.known:
                name = detections[0].name if detections else next(iter(self.known))
                self.supervisor.latch(f"obstacle {name}: the agent has no obstacle slots", stamp)
            return
        for detection in detections:
            try:
                self.tracker.observe(detection)
            except ConfigError:
                # late, or on a clock that went back: the track is as it was, and grows old if no other comes
                self.refused += 1
        faults = self.tracker.faults(stamp)
        if wanted := [fault for name, fault in faults.items() if self._slots.wants(name, self.tracker.kind(name))]:
            self.supervisor.latch(wanted[0], stamp)
            self._obstacles = [obstacle.at_rest() for obstacle in self._obstacles]
            return
        there = {**self.tracker.obstacles(stamp, faults), **self.known}
        self._obstacles = self._slots.fill(there, self.controller.kin.com)
        for name in self._slots.left_out:
            if (kind := there[name].kind) not in self._slots.kinds:
                self.supervisor.latch(f"obstacle {name} is a {kind}: the agent has no slot for one", stamp)

    # -- references

    def _move_references(self, state: RobotState) -> None:
        """References of this tick. After a stop a gait comes to rest, and hands stay where they are beside it."""
        t, stopped = state.stamp - self._start_time, self.supervisor.cause is not None
        reference = self.reference
        if self.gait is not None:
            if stopped:
                self.gait.stop()
            self.gait.apply(reference, t, state, self.controller.kin)
        last = min(t, self.supervisor.stopped_at - self._start_time) if stopped else t
        for motion in self.motions:
            motion.apply(reference, last)
        self._check_hands(state.stamp)
        if stopped:
            for hand in reference.hands or ():
                hand.velocity, hand.acceleration = np.zeros(3), np.zeros(3)
            reference.hand_turns[:] = 0.0

    def _check_hands(self, stamp: float) -> None:
        """A hand sent to no number holds the robot, with both hands where they were sent last."""
        reference = self.reference
        if reference.hands is None:
            return
        axes = reference.hand_rotations or (STILL, STILL)
        for name, hand, rotation, turn in zip(HANDS, reference.hands, axes, reference.hand_turns, strict=True):
            if not all_finite(hand.position, hand.velocity, hand.acceleration, rotation, turn):
                self.supervisor.latch(f"reference of the {name} is not finite", stamp)
                self._send_hands_back()
                return
        self._keep_hands()

    def _keep_hands(self) -> None:
        """Remember where the hands are sent: copies, since whoever sends them may write to the same arrays again."""
        left, right = self.reference.hands or (None, None)
        self._sound_points = () if left is None or right is None else (left.position.copy(), right.position.copy())
        self._sound_axes = tuple(axes.copy() for axes in self.reference.hand_rotations or ())

    def _send_hands_back(self) -> None:
        """Both hands where they were sent last, at rest, in references of their own."""
        reference = self.reference
        left, right = (PointReference(point.copy()) for point in self._sound_points)
        reference.hands, reference.hand_turns = (left, right), np.zeros((2, 3))
        if self._sound_axes:
            of_left, of_right = (axes.copy() for axes in self._sound_axes)
            reference.hand_rotations = of_left, of_right

    def _asked_for(self) -> WholeBodyReference:
        """The reference of this tick; after a stop without a gait, that of the moment of the stop, at rest."""
        if self.supervisor.cause is None or self.gait is not None or self.supervisor.fading:
            return self.reference
        if self._frozen is None:
            self._frozen = self.reference.at_rest()
        return self._frozen
