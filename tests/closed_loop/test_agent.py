"""The agent in closed loop, and nobody but the loop around it: stops, and what changes between ticks."""

import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.agent import Agent, AgentOutput, MakeGait
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.one_leg import OneLeg, OneLegTuning
from controllers.gaits.walking import CommandedWalk, Walking, walk_tuning, walking_changes
from controllers.motions.hand_targets import HandTargets
from controllers.motions.hands import HandCircles
from controllers.perception import Detection
from controllers.reference import PointReference, WholeBodyReference
from controllers.whole_body.robot_config import controller_config, from_table
from experiments.running.ground_truth import TrueBarriers
from experiments.running.loop import ClosedLoop, Observer
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from safety.geometry.shapes import Obstacle
from sims.plant import MujocoPlant, PlantConfig

HEAVY = PhysicalChanges(mass_scale=1.2)


class Watch(Observer):
    """Keeps the last of everything, and calls ``act`` before every tick."""

    def __init__(self, act: Callable[[ClosedLoop[Any]], None] | None = None) -> None:
        self.act = act
        self.outputs: list[AgentOutput] = []

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: AgentOutput, seconds: float) -> None:
        self.outputs.append(output)

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        if self.act is not None:
            self.act(loop)
        return False


class Seen:
    """A world in which ``what(t)`` is detected at every tick."""

    def __init__(self, what: Callable[[float], dict[str, Obstacle]]) -> None:
        self.what = what

    def detections(self, t: float) -> Sequence[Detection]:
        return [Detection(name, t, shape) for name, shape in self.what(t).items()]

    def act(self, t: float) -> None:
        pass


def standing_plant(robot: RobotDescription, posture: str = "standing", heavy: bool = False) -> MujocoPlant:
    config = PlantConfig(changes=HEAVY if heavy else PhysicalChanges())
    plant = MujocoPlant(robot, config, np.random.default_rng(0))
    plant.reset(standing_configuration(robot, posture))
    return plant


def hand_agent(robot: RobotDescription, **options: object) -> tuple[MujocoPlant, Agent]:
    plant = standing_plant(robot, "hands_front")
    agent = Agent(robot, motions=[HandTargets], with_hands=True, **options)
    agent.reset(plant.state())
    return plant, agent


def targets_of(agent: Agent) -> HandTargets:
    (motion,) = (m for m in agent.motions if isinstance(m, HandTargets))
    return motion


def left_hand(plant: MujocoPlant) -> Array:
    return plant.frame_position(plant.robot.roles["left_hand"])


def is_upright(plant: MujocoPlant, height: float) -> bool:
    q = plant.true_state().q
    return bool(1 - 2 * (q[3] ** 2 + q[4] ** 2) > 0.98 and abs(q[2] - height) < 0.05)


# --- stops


def walking_agent(robot: RobotDescription) -> Agent:
    def gait(kin: Kinematics) -> CommandedWalk:
        return CommandedWalk(Walking(kin, walk_tuning(robot)), lambda t: VelocityCommand(vx=0.2))

    config = controller_config(robot, **walking_changes(robot, load_estimate=True))
    return Agent(robot, config, gait=gait)


def test_a_hold_in_mid_step_ends_on_both_feet(robot: RobotDescription) -> None:
    """Nobody helps: the gait is stopped, the step closes, and the robot stands still."""
    plant, agent = standing_plant(robot, heavy=True), walking_agent(robot)
    agent.reset(plant.state())
    height = float(plant.true_state().q[2])
    loop = ClosedLoop(plant, agent, steps=2)
    loop.run(2.5)
    while agent.reference.in_contact.all():
        assert loop.step()
    for _ in range(40):
        loop.step()
    assert agent.reference.in_contact.sum() == 1, "not in mid-step"
    agent.hold("because")
    start = plant.center_of_mass().copy()
    loop.run(4.5)
    assert agent.stop_cause == "because"
    assert agent.reference.in_contact.all()
    assert is_upright(plant, height)
    assert np.abs(plant.true_state().v).max() < 0.1
    force = plant.contact_wrenches()[:, 2]
    assert 0.3 < force[0] / force.sum() < 0.7
    soles = plant.sole_corners().mean(axis=1)
    assert abs(soles[0, 0] - soles[1, 0]) < 0.03
    # the rest of this step and the one that closes
    assert plant.center_of_mass()[0] - start[0] < 0.35


def test_a_hold_on_one_leg_ends_on_both_feet(robot: RobotDescription) -> None:
    def gait(kin: Kinematics) -> OneLeg:
        return OneLeg(kin, from_table(OneLegTuning, robot, "taichi"))

    plant = standing_plant(robot)
    agent = Agent(robot, gait=gait)
    agent.reset(plant.state())
    height, loop = float(plant.true_state().q[2]), ClosedLoop(plant, agent, steps=2)
    while agent.reference.in_contact.all():
        assert loop.step()
    loop.run(1.0)
    agent.hold("because")
    loop.run(6.0)
    assert agent.reference.in_contact.all()
    assert is_upright(plant, height)
    force = plant.contact_wrenches()[:, 2]
    assert force.min() > 0.2 * force.sum()


@pytest.mark.parametrize("side", [0, 1])
def test_a_hand_sent_to_no_number_holds_the_robot(robot: RobotDescription, side: int) -> None:
    """The hand stays where it was sent last; balance is kept, and the cause names the hand."""

    class Broken:
        def apply(self, reference: WholeBodyReference, t: float) -> None:
            hands = [PointReference(p.copy()) for p in starts]
            if t > 0.2:
                hands[side].position[1] = np.nan
            reference.hands = hands[0], hands[1]

    plant = standing_plant(robot, "hands_front")
    agent = Agent(robot, with_hands=True)
    agent.reset(plant.state())
    assert agent.reference.hands is not None
    starts = [hand.position.copy() for hand in agent.reference.hands]
    agent.motions.append(Broken())
    height = float(plant.true_state().q[2])
    watch = Watch()
    ClosedLoop(plant, agent, observers=[watch], steps=2).run(2.5)
    assert agent.stop_cause == f"reference of the {('left', 'right')[side]} hand is not finite"
    assert all(output.result is not None for output in watch.outputs)
    assert is_upright(plant, height)
    np.testing.assert_allclose(left_hand(plant), starts[0], rtol=0, atol=0.01)


def test_axes_of_a_hand_that_are_no_numbers_hold_the_robot(robot: RobotDescription) -> None:
    plant = standing_plant(robot, "hands_front")
    agent = Agent(robot, controller_config(robot, hand_task="pose"), with_hands=True)
    agent.reset(plant.state())
    assert agent.reference.hand_rotations is not None
    agent.reference.hand_rotations[1][0, 0] = np.nan
    height, watch = float(plant.true_state().q[2]), Watch()
    ClosedLoop(plant, agent, observers=[watch], steps=2).run(1.0)
    assert agent.stop_cause == "reference of the right hand is not finite"
    assert all(output.result is not None for output in watch.outputs)
    assert is_upright(plant, height)


def test_a_state_that_is_none_fades_the_motors_out_and_moves_nothing(robot: RobotDescription) -> None:
    plant, agent = hand_agent(robot)
    good = plant.state()
    agent.tick(good)
    broken = plant.state()
    broken.q[7] = np.nan
    output = agent.tick(broken)
    assert output.result is None
    assert agent.supervisor.fading
    assert np.isfinite(output.command.tau).all()


def test_the_first_state_may_be_the_broken_one(robot: RobotDescription) -> None:
    plant = standing_plant(robot)
    agent, state = Agent(robot), plant.state()
    state.q[7] = np.nan
    command = agent.tick(state).command
    np.testing.assert_array_equal(command.kp, 0.0)
    assert agent.stop_cause is not None
    assert agent.tick(plant.state()).result is None


# --- obstacles that appear and go


def sphere_at(place: Array, velocity: Array | None = None) -> Obstacle:
    return Obstacle.sphere(place, 0.08, velocity)


def test_obstacles_appear_and_go(robot: RobotDescription) -> None:
    """A sphere where the hand is pushes it away; once it is gone the hand comes back; nothing stops the robot."""
    plant, agent = hand_agent(robot, obstacle_slots=("sphere", "sphere"))
    start = left_hand(plant)
    place = start + np.array([0.12, 0.0, 0.0])

    def around(t: float) -> dict[str, Obstacle]:
        return {"ball": sphere_at(place)} if 0.5 < t < 2.0 else {}

    def forgets(loop: ClosedLoop[Any]) -> None:
        if loop.time > 2.0:
            agent.forget("ball")

    truth, watch = TrueBarriers(robot, ("sphere",)), Watch(forgets)
    loop = ClosedLoop(plant, agent, Seen(around), [watch], 2)
    loop.run(0.5)
    np.testing.assert_allclose(left_hand(plant), start, rtol=0, atol=0.01)
    loop.run(1.4)
    h = truth.evaluate(plant.true_state().q, [sphere_at(place)]).h[truth.slices["obstacle"]].min()
    assert h > 0.0
    loop.run(2.5)
    assert agent.stop_cause is None
    np.testing.assert_allclose(left_hand(plant), start, rtol=0, atol=0.01)


def test_more_obstacles_than_slots_stop_nobody(robot: RobotDescription) -> None:
    """Today's nearest count, and the others are named."""
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    start = left_hand(plant)
    crowd = {f"ball {i}": sphere_at(start + np.array([0.3 + 0.3 * i, 0.0, 0.0])) for i in range(4)}
    watch = Watch()
    ClosedLoop(plant, agent, Seen(lambda t: crowd), [watch], 2).run(0.2)
    assert agent.stop_cause is None
    assert set(agent.left_out) == {"ball 1", "ball 2", "ball 3"}
    np.testing.assert_allclose(watch.outputs[-1].obstacles[0].position, crowd["ball 0"].position, rtol=0, atol=1e-6)


def test_a_track_that_grows_old_holds_the_robot_by_name(robot: RobotDescription) -> None:
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    place, rate = left_hand(plant) + np.array([0.6, 0.0, 0.0]), np.array([0.1, 0.0, 0.0])
    seen = Seen(lambda t: {"ball": sphere_at(place + t * rate)} if t < 0.3 else {})
    watch = Watch()
    ClosedLoop(plant, agent, seen, [watch], 2).run(1.0)
    assert agent.stop_cause is not None
    assert agent.stop_cause.startswith("track of ball is")
    last = watch.outputs[-1]
    assert last.result is not None, "a hold computes on"
    np.testing.assert_array_equal(last.obstacles[0].velocity, 0.0)


def test_a_detection_of_the_past_is_dropped_and_counted(robot: RobotDescription) -> None:
    """Two packets out of order are no reason to stop; the track is as it was."""
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    place = np.array([3.0, 0.0, 1.0])
    for stamp, shape in ((0.0, sphere_at(place)), (0.002, sphere_at(place)), (0.0, Obstacle.sphere(place, 0.01))):
        output = agent.tick(plant.state(), [Detection("ball", stamp, shape)])
        plant.send(output.command)
        plant.advance(agent.dt)
    assert agent.stop_cause is None
    assert agent.refused == 1
    assert output.obstacles[0].radius == 0.08


def test_an_outlier_changes_nothing_of_an_obstacle(robot: RobotDescription) -> None:
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    place = np.array([3.0, 0.0, 1.0])
    for k in range(8):
        detection = Detection("ball", 0.002 * k, sphere_at(place))
        if k == 6:
            detection = Detection("ball", 0.002 * k, Obstacle.sphere(place + 5.0, 0.01, np.full(3, 9.0)))
        output = agent.tick(plant.state(), [detection])
        plant.send(output.command)
        plant.advance(agent.dt)
        assert output.obstacles[0].radius == 0.08
        np.testing.assert_allclose(output.obstacles[0].position, place, rtol=0, atol=1e-3)


@pytest.mark.parametrize("slots", [(), ("box",)])
def test_an_obstacle_that_nothing_keeps_the_robot_from_holds_it(
    robot: RobotDescription, slots: tuple[str, ...]
) -> None:
    for known in (False, True):
        plant, agent = hand_agent(robot, obstacle_slots=slots)
        far = sphere_at(np.array([3.0, 0.0, 1.0]))
        agent.known = {"ball": far} if known else {}
        output = agent.tick(plant.state(), [] if known else [Detection("ball", 0.0, far)])
        assert agent.stop_cause is not None
        assert agent.stop_cause.startswith("obstacle ball")
        assert output.result is not None, "a hold computes on"


def test_a_distant_obstacle_without_a_slot_may_be_lost(robot: RobotDescription) -> None:
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    near, far = sphere_at(np.array([3.0, 0.0, 1.0])), sphere_at(np.array([50.0, 0.0, 1.0]))
    seen = Seen(lambda t: {"near": near, "far": far} if t < 0.1 else {"near": near})
    ClosedLoop(plant, agent, seen, steps=2).run(0.8)
    assert agent.stop_cause is None
    assert agent.left_out in {(), ("far",)}


def test_the_clock_of_a_body_may_begin_anywhere(robot: RobotDescription) -> None:
    class Later:
        def __init__(self, body: MujocoPlant) -> None:
            self.send, self.advance, self._body = body.send, body.advance, body

        def state(self) -> RobotState:
            state = self._body.state()
            return replace(state, stamp=state.stamp + 100.0)

    plant = standing_plant(robot, "hands_front")
    agent = Agent(robot, with_hands=True, obstacle_slots=("sphere",))
    far = sphere_at(np.array([3.0, 0.0, 1.0]))
    ClosedLoop(Later(plant), agent, Seen(lambda t: {"ball": far}), steps=2).run(0.5)
    assert agent.stop_cause is None


# --- mistakes of others


def test_a_motion_that_raises_holds_the_robot(robot: RobotDescription, caplog: pytest.LogCaptureFixture) -> None:
    class Mistaken:
        def apply(self, reference: WholeBodyReference, t: float) -> None:
            if t > 0.1:
                raise ZeroDivisionError("division by zero")

    plant, agent = hand_agent(robot)
    agent.motions.append(Mistaken())
    height, watch = float(plant.true_state().q[2]), Watch()
    ClosedLoop(plant, agent, observers=[watch], steps=2).run(1.0)
    assert agent.stop_cause == "references: ZeroDivisionError: division by zero"
    assert all(output.result is not None for output in watch.outputs)
    assert is_upright(plant, height)
    assert "Mistaken" in caplog.text or "apply" in caplog.text


@pytest.mark.parametrize("part", ["com", "joints"])
def test_references_that_are_no_numbers_hold_the_robot(robot: RobotDescription, part: str) -> None:
    class Broken:
        def apply(self, reference: WholeBodyReference, t: float) -> None:
            if t > 0.1:
                reference.com.position = reference.com.position * (np.nan if part == "com" else 1.0)
                reference.joints = reference.joints * (np.nan if part == "joints" else 1.0)

    plant, agent = hand_agent(robot)
    agent.motions.append(Broken())
    height = float(plant.true_state().q[2])
    ClosedLoop(plant, agent, steps=2).run(2.0)
    assert agent.stop_cause == "the references are not finite"
    assert not agent.supervisor.fading
    assert is_upright(plant, height)


def test_a_stop_before_the_first_tick_stays(robot: RobotDescription) -> None:
    plant, agent = standing_plant(robot), Agent(robot)
    agent.hold("not yet")
    output = agent.tick(plant.state())
    assert agent.stop_cause == "not yet"
    assert output.result is not None
    agent.reset(plant.state())
    assert agent.stop_cause is None


def test_a_new_start_forgets_what_the_robot_weighed(robot: RobotDescription) -> None:
    plant, agent = standing_plant(robot, heavy=True), walking_agent(robot)
    agent.reset(plant.state())
    ClosedLoop(plant, agent, steps=2).run(1.0)
    load = agent.controller.load
    assert load is not None
    assert load.scale > 1.05
    agent.reset(plant.state())
    assert load.scale == 1.0


# --- hand targets


def test_a_hand_follows_targets_in_the_world(robot: RobotDescription) -> None:
    plant, agent = hand_agent(robot)
    start = left_hand(plant)
    loop = ClosedLoop(plant, agent, steps=2)
    for offset in ([0.0, 0.05, 0.06], [0.03, 0.0, -0.04]):
        targets_of(agent).set("left", start + np.array(offset))
        loop.run(2.0)
        np.testing.assert_allclose(left_hand(plant), start + np.array(offset), rtol=0, atol=0.01)


def test_a_target_in_the_heading_frame_goes_along(robot: RobotDescription) -> None:
    """The same numbers, wherever the robot stands and looks."""
    plant, agent = hand_agent(robot)
    com, start = agent.reference.com.position, left_hand(plant)
    ground = np.array([com[0], com[1], plant.sole_corners()[..., 2].mean()])
    targets_of(agent).set("left", start - ground + np.array([0.0, 0.04, 0.03]), "heading")
    ClosedLoop(plant, agent, steps=2).run(2.0)
    np.testing.assert_allclose(left_hand(plant), start + np.array([0.0, 0.04, 0.03]), rtol=0, atol=0.012)


def test_a_reference_of_a_hand_never_jumps(robot: RobotDescription) -> None:
    """Targets a metre apart from one tick to the next: position, speed and acceleration stay within the limits."""
    _, agent = hand_agent(robot)
    motion, reference, rng = targets_of(agent), agent.reference, np.random.default_rng(3)
    points = []
    for k in range(3000):
        if k % 40 == 0:
            motion.set("left", rng.uniform(-1.0, 1.0, 3), ("world", "heading")[k % 80 // 40])
        motion.apply(reference, 0.002 * k)
        assert reference.hands is not None
        points.append(reference.hands[0].position)
    rates = np.diff(points, axis=0) / 0.002
    assert np.linalg.norm(rates, axis=1).max() <= motion.limits.speed * (1 + 1e-9)
    assert np.linalg.norm(np.diff(rates, axis=0), axis=1).max() <= 0.002 * motion.limits.acceleration * (1 + 1e-9)


def test_a_target_that_is_no_place_changes_nothing(robot: RobotDescription) -> None:
    _, agent = hand_agent(robot)
    motion = targets_of(agent)
    for bad in (np.array([np.nan, 0.0, 0.0]), np.zeros(2), np.array([np.inf, 0.0, 0.0])):
        with pytest.raises(ConfigError, match="target of the left hand"):
            motion.set("left", bad)
    with pytest.raises(ConfigError, match="side = 'middle'"):
        motion.set("middle", np.zeros(3))
    with pytest.raises(ConfigError, match="frame = 'camera'"):
        motion.set("left", np.zeros(3), "camera")
    motion.apply(agent.reference, 0.0)
    motion.apply(agent.reference, 1.0)
    assert agent.reference.hands is not None
    np.testing.assert_array_equal(agent.reference.hands[0].velocity, 0.0)


def test_circles_are_made_for_the_robot(robot: RobotDescription) -> None:
    plant = standing_plant(robot, "hands_front")
    agent = Agent(robot, motions=[HandCircles.for_robot], with_hands=True)
    agent.reset(plant.state())
    start = left_hand(plant)
    ClosedLoop(plant, agent, steps=2).run(1.0)
    assert np.linalg.norm(left_hand(plant) - start) > 0.02
    assert agent.stop_cause is None
    with pytest.raises(ConfigError, match="with_hands"):
        Agent(robot, motions=[HandCircles.for_robot]).reset(plant.state())


# --- for hours


def test_without_a_recorder_nothing_is_kept(robot: RobotDescription) -> None:
    """After two seconds a further one leaves less than a kilobyte behind.

    What is kept of ticks grows in every second; what something else keeps once, in one of three.
    """
    plant, agent = hand_agent(robot, obstacle_slots=("sphere",))
    place = left_hand(plant) + np.array([0.5, 0.0, 0.0])
    loop = ClosedLoop(plant, agent, Seen(lambda t: {"ball": sphere_at(place)}), steps=2)
    loop.run(2.0)
    tracemalloc.start()
    loop.run(0.1)
    kept = []
    for _ in range(3):
        before = tracemalloc.get_traced_memory()[0]
        loop.run(1.0)
        kept.append(tracemalloc.get_traced_memory()[0] - before)
    tracemalloc.stop()
    assert min(kept) < 1024, kept


def test_a_gait_may_be_any(robot: RobotDescription) -> None:
    """The agent asks nothing of a gait but what the protocol has."""

    class Still:
        stopped = 0

        def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: Kinematics) -> None:
            reference.turn_rate = 0.0

        def stop(self) -> None:
            self.stopped += 1

    still = Still()
    make: MakeGait = lambda kin: still  # noqa: E731
    plant, agent = standing_plant(robot), Agent(robot, gait=make)
    loop = ClosedLoop(plant, agent, steps=2)
    loop.run(0.1)
    assert still.stopped == 0
    agent.hold("because")
    loop.run(0.1)
    assert still.stopped > 0
