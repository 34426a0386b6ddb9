"""Forces under the feet, contacts, and the estimate of the whole state, against the simulator's truth."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from controllers.agent import Agent
from controllers.estimation.bias_watch import BiasDoubt, BiasWatch
from controllers.estimation.contact_belief import ContactBelief, ContactCues
from controllers.estimation.estimated_body import EstimatedBody
from controllers.estimation.estimator import BASE_FILTERS, EstimatorSettings, StateEstimator
from controllers.estimation.invariant_filter import FilterNoise, InvariantFilter
from controllers.estimation.momentum_observer import SLIDES, MomentumObserver, leg_columns
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.walking import CommandedWalk, Walking, walk_tuning
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, Mask, SensorReading
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant, PlantConfig
from sims.sensors import NO_ERRORS, SensorErrors, Sensors

DT = 0.002


class Standing:
    """A robot that stands by its own controller, on the true state, without friction in its joints."""

    def __init__(self, name: str, mass_scale: float = 1.0) -> None:
        changes = PhysicalChanges(mass_scale=mass_scale, joint_friction_scale=0.0)
        self.plant = MujocoPlant(load_robot(name), PlantConfig(changes=changes))
        self.agent = Agent(self.plant.robot, settle_time=0.0)
        self.agent.reset(self.plant.true_state())
        self.advance(1.0)

    def advance(self, time: float = DT) -> None:
        for _ in range(round(time / DT)):
            self.plant.send(self.agent.tick(self.plant.true_state()).command)
            self.plant.advance(DT)


@pytest.mark.parametrize("mass_scale", [0.8, 1.0, 1.3])
def test_at_rest_the_legs_tell_what_the_feet_bear_whatever_the_trunk_weighs(robot_name: str, mass_scale: float) -> None:
    """All but the legs' own share of the mismatch: the observer knows the nominal legs."""
    standing = Standing(robot_name, mass_scale)
    plant, observer = standing.plant, MomentumObserver(standing.plant.robot, 100.0)
    for _ in range(100):
        standing.advance()
        state = plant.true_state()
        found = observer.update(state.q, state.v, state.tau, DT)
    true = plant.contact_wrenches()
    weight = plant.total_mass * 9.81
    assert found[:, 2].sum() == pytest.approx(weight, rel=0.02 if mass_scale == 1.0 else 0.09)
    assert np.abs(found[:, 2] - true[:, 2]).max() < (0.02 if mass_scale == 1.0 else 0.06) * weight


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_the_observer_follows_a_step_as_a_first_order_lag(robot_name: str, speed: float) -> None:
    """Against rigid-body dynamics integrated finely, with a force that begins at once; also of a robot in motion."""
    robot = load_robot(robot_name)
    damping, dry = robot.joint_array("damping"), robot.joint_array("friction_loss")
    kin, K, dt = Kinematics(robot), 100.0, 5e-5
    sole = kin.frame_id(robot.soles[0].frame)
    leg = leg_columns(kin, sole)
    q, v = standing_configuration(robot, "standing"), speed * np.random.default_rng(4).normal(size=kin.nv)
    observer, force = MomentumObserver(robot, K), np.array([20.0, -10.0, 200.0, 3.0, 5.0, -1.0])
    followed = []
    for k in range(400):
        kin.update(q, v)
        jacobian = kin.frame_jacobian(sole, local=True)
        torque = np.zeros(kin.nv - 6)
        external = jacobian.T @ force if k > 0 else np.zeros(kin.nv)
        friction = damping * v[6:] + dry * np.tanh(v[6:] / SLIDES)
        balance = np.concatenate([np.zeros(6), torque - friction]) + external - kin.bias
        found = observer.update(q, v, torque, dt)
        # it begins by taking what nothing holds for held from outside
        followed.append(found[0])
        acceleration = np.linalg.solve(np.array(kin.mass_matrix), balance)
        v = v + dt * acceleration
        q = pin.integrate(kin.model, q, v * dt)
    first = followed[0]
    t = dt * np.arange(400)
    expected = force + (first - force) * np.exp(-K * t)[:, None]
    error = np.abs(np.array(followed) - expected).max(axis=0)
    # the lag is that of the joints' torques, and the leg moves meanwhile
    assert (error < 0.05 * np.abs(first - force).max()).all()
    assert leg.size == 6


def test_a_leg_has_six_joints() -> None:
    kin = Kinematics(load_robot("g1"))
    with pytest.raises(ConfigError, match="joints of a leg"):
        leg_columns(kin, kin.frame_id(kin.robot.roles["torso"]))
    with pytest.raises(ConfigError, match="bandwidth"):
        MomentumObserver(load_robot("g1"), 0.0)


# --- contacts


def believe(forces: float, speed: float, planned: bool | None, ticks: int = 50) -> float:
    belief = ContactBelief(350.0)
    plan = None if planned is None else np.array([planned, True])
    for _ in range(ticks):
        belief.update(np.array([forces, 200.0]), np.array([speed, 0.0]), plan, DT)
    return float(belief.probability[0])


def test_each_cue_speaks_for_or_against_a_contact_and_none_alone_decides() -> None:
    grid = [believe(f, 0.0, None) for f in (-50.0, 0.0, 10.0, 28.0, 60.0, 300.0)]
    assert (np.diff(grid) >= 0).all() and grid[0] < 0.01 and grid[3] == pytest.approx(0.5) and grid[-1] > 0.99
    assert believe(28.0, 0.0, False) < 0.5 < believe(28.0, 0.0, True)
    assert believe(40.0, 0.0, None) > believe(40.0, 0.3, None) > believe(40.0, 2.0, None)
    # a plan does not make a foot stand that bears nothing, nor a loaded one hang in the air
    assert believe(0.0, 0.0, True) < 0.1
    assert believe(150.0, 0.0, False) > 0.9
    assert believe(1e9, 0.0, False) == pytest.approx(believe(300.0, 0.0, False))


def test_a_touchdown_is_believed_within_some_ticks() -> None:
    belief = ContactBelief(350.0)
    off, on = np.array([0.0, 350.0]), np.array([120.0, 230.0])
    for _ in range(100):
        belief.update(off, np.array([0.4, 0.0]), np.array([False, True]), DT)
    assert belief.probability[0] < 0.01 and belief.probability[1] > 0.99
    ticks = 0
    while belief.probability[0] < 0.5:
        belief.update(on, np.array([0.02, 0.0]), np.array([False, True]), DT)
        ticks += 1
    assert ticks <= 5


@pytest.mark.parametrize("name", ContactCues.__slots__)
def test_a_cue_that_is_none_is_refused_by_name(name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        ContactCues(**{name: -1.0})


# --- the whole estimate


def estimator_of(
    plant: MujocoPlant, errors: SensorErrors, seed: int = 0, **settings: object
) -> tuple[StateEstimator, Sensors]:
    sensors = Sensors(plant, errors, np.random.default_rng(seed))
    estimator = StateEstimator(plant.robot, EstimatorSettings(**settings))
    estimator.calibrate([sensors.read_at_rest() for _ in range(1000)], plant.true_state().q[:7])
    return estimator, sensors


@pytest.mark.parametrize("base", BASE_FILTERS)
def test_a_robot_that_stands_is_known_to_stand(robot_name: str, base: str) -> None:
    standing = Standing(robot_name)
    plant = standing.plant
    estimator, sensors = estimator_of(plant, SensorErrors(), base=base)
    bias = np.linalg.norm(estimator.filter.gyro_bias - sensors.gyro_bias)
    assert bias < 4 * 0.005 / np.sqrt(1000)
    rates = []
    for _ in range(500):
        standing.advance()
        state = estimator.update(sensors.read())
        rates.append(state.v[3:6] - plant.true_state().v[3:6])
    true = plant.true_state()
    assert np.abs(state.v[:6] - true.v[:6]).max() < 0.03
    # a tenth of the gyro's bias is left in the mean, which has lost the noise
    assert np.abs(np.mean(rates, axis=0)).max() < 2e-3
    assert np.abs(state.q[:3] - true.q[:3]).max() < 5e-3
    up = pin.Quaternion(state.q[3:7]).matrix()[2] @ pin.Quaternion(true.q[3:7]).matrix()[2]
    assert np.arccos(min(up, 1.0)) < 0.012
    assert state.contact is not None and (state.contact > 0.9).all()
    np.testing.assert_array_equal(state.stamp, plant.time)


def test_with_sensors_that_say_what_is_the_estimate_is_what_is(robot_name: str) -> None:
    standing = Standing(robot_name)
    plant = standing.plant
    estimator, sensors = estimator_of(plant, NO_ERRORS)
    for _ in range(250):
        standing.advance()
        state = estimator.update(sensors.read())
    true = plant.true_state()
    np.testing.assert_allclose(state.v, true.v, rtol=0, atol=2e-3)
    np.testing.assert_allclose(state.q, true.q, rtol=0, atol=1e-3)


def test_hanging_still_tells_the_bias_and_what_is_up() -> None:
    """Without being told where the base is: it looks along x, upright by gravity, its lower sole on the ground."""
    robot = load_robot("g1")
    plant = MujocoPlant(robot)
    tilted = standing_configuration(robot, "standing")
    tilted[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, -0.2, 0.7)).coeffs()
    plant.reset(tilted)
    sensors = Sensors(plant, SensorErrors(accelerometer_bias=0.0), np.random.default_rng(1))
    estimator = StateEstimator(robot)
    state = estimator.calibrate([sensors.read_at_rest() for _ in range(2000)])
    expected = pin.rpy.rpyToMatrix(0.1, -0.2, 0.0)
    found = pin.Quaternion(state.q[3:7]).matrix()
    np.testing.assert_allclose(found[2], pin.rpy.rpyToMatrix(0.1, -0.2, 0.7)[2], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found[2], expected[2], rtol=0, atol=1e-3)
    assert found[1, 0] == pytest.approx(0.0, abs=1e-9)
    kin = Kinematics(robot)
    kin.update_geometry(state.q)
    heights = [kin.frame_placement(kin.frame_id(s.frame))[1][2] for s in robot.soles]
    assert min(heights) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["gyro", "accelerometer", "joint_position", "joint_velocity", "torque"])
def test_a_reading_that_is_not_finite_changes_nothing(name: str) -> None:
    standing = Standing("g1")
    plant = standing.plant
    estimator, sensors = estimator_of(plant, NO_ERRORS)
    standing.advance()
    sound = estimator.update(sensors.read())
    standing.advance()
    reading = sensors.read()
    broken = getattr(reading, name).copy()
    broken[0] = np.nan
    again = estimator.update(replace(reading, **{name: broken}))
    assert again is sound and estimator.refused == 1
    # one that comes late neither, and the next sound one is taken
    assert estimator.update(replace(reading, stamp=0.0)) is sound
    state = estimator.update(reading)
    assert state.stamp == reading.stamp
    np.testing.assert_allclose(state.q, plant.true_state().q, rtol=0, atol=2e-3)


def test_an_estimate_before_the_calibration_is_refused() -> None:
    estimator = StateEstimator(load_robot("g1"))
    nothing = np.zeros(29)
    reading = SensorReading(nothing, nothing, nothing, np.zeros(3), np.zeros(3), 0.0)
    with pytest.raises(ConfigError, match="calibrated"):
        estimator.update(reading)
    with pytest.raises(ConfigError, match="readings"):
        estimator.calibrate([])


def test_a_body_is_told_what_is_estimated_and_commanded_what_is_sent() -> None:
    standing = Standing("g1")
    plant = standing.plant
    estimator, sensors = estimator_of(plant, NO_ERRORS)
    body = EstimatedBody(plant, sensors.read, estimator)
    body.send(standing.agent.tick(plant.true_state()).command)
    begun = plant.time
    body.advance(DT)
    state = body.state()
    assert plant.time == pytest.approx(begun + DT)
    assert state is body.estimate and state.contact is not None
    assert body.seconds > 0.0


def test_the_gyros_drift_is_followed() -> None:
    """0.003 rad/s a minute, as fast as it is drawn, while the robot stands: half a minute of it."""
    standing = Standing("g1")
    plant = standing.plant
    estimator, sensors = estimator_of(plant, SensorErrors(gyro_drift=0.003 / 60.0))
    for _ in range(15_000):
        standing.advance()
        estimator.update(sensors.read())
    moved = 0.003 / 60.0 * 30.0
    assert np.linalg.norm(estimator.filter.gyro_bias - sensors.gyro_bias) < 0.5 * moved


def test_a_reading_that_was_taken_in_is_not_taken_in_again() -> None:
    """The same news twice is no better news: neither state nor covariance move."""
    standing = Standing("g1")
    estimator, sensors = estimator_of(standing.plant, SensorErrors())
    standing.advance()
    reading = sensors.read()
    first, kept = estimator.update(reading), estimator.filter
    assert isinstance(kept, InvariantFilter)
    covariance = kept.covariance.copy()
    assert estimator.update(reading) is first
    np.testing.assert_array_equal(kept.covariance, covariance)


def test_a_calibration_with_a_reading_that_is_none_is_refused() -> None:
    standing = Standing("g1")
    estimator, sensors = estimator_of(standing.plant, NO_ERRORS)
    before = estimator.filter.rotation.copy()
    readings = [sensors.read_at_rest() for _ in range(3)]
    readings[1] = replace(readings[1], gyro=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ConfigError, match="reading 1"):
        estimator.calibrate(readings)
    np.testing.assert_array_equal(estimator.filter.rotation, before)


class Turning:
    """A G1 that walks in a turn, on the true state."""

    def __init__(self, robot: RobotDescription) -> None:
        self.plant = MujocoPlant(robot)
        self.agent = Agent(robot, gait=self._walk, settle_time=0.0)
        self.agent.reset(self.plant.true_state())

    def _walk(self, kin: Kinematics) -> CommandedWalk:
        return CommandedWalk(Walking(kin, walk_tuning(kin.robot)), lambda t: VelocityCommand(vx=0.1, wz=0.3))

    def advance(self) -> None:
        self.plant.send(self.agent.tick(self.plant.true_state()).command)
        self.plant.advance(DT)


def estimates(base: str, **mount: Array) -> tuple[Array, Array]:
    """Estimated and true velocity and position of the base (T, 9) in a turn, with an IMU that is mounted otherwise."""
    g1 = load_robot("g1")
    frames = tuple(replace(f, **mount) if f.name == g1.roles["imu"] else f for f in g1.frames)
    turning = Turning(replace(g1, frames=frames))
    estimator, sensors = estimator_of(turning.plant, NO_ERRORS, base=base)
    told, real = [], []
    for _ in range(1500):
        turning.advance()
        state, true = estimator.update(sensors.read()), turning.plant.true_state()
        told.append(np.concatenate([state.v[:6], state.q[:3]]))
        real.append(np.concatenate([true.v[:6], true.q[:3]]))
    return np.array(told), np.array(real)


@pytest.mark.parametrize("base", BASE_FILTERS)
def test_it_does_not_matter_how_the_imu_is_mounted(base: str) -> None:
    """Turned on the pelvis of a robot that walks in a turn: the same estimate. Moved: the base's own velocity still."""
    usual, true = estimates(base)
    assert np.abs(true[:, 5]).max() > 0.1
    turned, _ = estimates(base, rpy=np.array([0.4, 1.1, -2.0]))
    np.testing.assert_allclose(turned, usual, rtol=0, atol=1e-9)
    moved, true = estimates(base, xyz=np.array([0.1, -0.05, 0.0]))
    # farther from the pelvis more of the shock of a step falls between two readings
    assert (np.sqrt(np.mean((moved - true) ** 2, axis=0)) < 0.02).all()


class Overheard(ContactBelief):
    """Keeps what it is told."""

    def update(self, forces: Array, speeds: Array, planned: Mask | None, dt: float) -> Array:
        self.told = forces.copy(), speeds.copy(), planned
        return super().update(forces, speeds, planned, dt)


def test_contacts_are_told_the_soles_speeds_their_forces_and_the_plan() -> None:
    turning = Turning(load_robot("g1"))
    plant, agent = turning.plant, turning.agent
    sensors = Sensors(plant, NO_ERRORS, np.random.default_rng(0))
    estimator = StateEstimator(plant.robot, plan=lambda: agent.reference.in_contact)
    estimator.calibrate([sensors.read_at_rest()], plant.true_state().q[:7])
    estimator.contact = told = Overheard(9.81 * plant.robot.total_mass)
    before, fastest, off = plant.sole_corners().mean(axis=1), 0.0, 0.0
    for _ in range(1500):
        turning.advance()
        estimator.update(sensors.read())
        forces, speeds, planned = told.told
        here = plant.sole_corners().mean(axis=1)
        real, before = np.linalg.norm(here - before, axis=1) / DT, here
        fastest, off = max(fastest, real.max()), max(off, float(np.abs(speeds - real).mean()))
        np.testing.assert_array_equal(forces, estimator.wrenches[:, 2])
        np.testing.assert_array_equal(planned, agent.reference.in_contact)
    assert fastest > 0.3
    assert off < 0.2 * fastest


def test_on_level_ground_the_height_does_not_drift_and_elsewhere_it_does() -> None:
    errors = {}
    for level in (True, False):
        turning = Turning(load_robot("g1"))
        plant, sensors = turning.plant, Sensors(turning.plant, SensorErrors(), np.random.default_rng(0))
        estimator = StateEstimator(plant.robot, EstimatorSettings(level_ground=level))
        estimator.calibrate([sensors.read_at_rest() for _ in range(500)], plant.true_state().q[:7])
        for _ in range(3000):
            turning.advance()
            state = estimator.update(sensors.read())
        errors[level] = abs(state.q[2] - plant.true_state().q[2])
    assert errors[True] < 2e-3
    assert errors[False] > 2 * errors[True]


# --- the simulated sensors


def test_sensors_err_as_they_say() -> None:
    """Biases by their length, noise by its deviation, a drift by its rate, a torque by its constant."""
    standing = Standing("g1")
    plant, errors = standing.plant, SensorErrors(gyro_drift=0.1, torque_scale=0.9)
    sensors = Sensors(plant, errors, np.random.default_rng(3))
    assert np.linalg.norm(sensors.gyro_bias) == pytest.approx(0.01)
    assert np.linalg.norm(sensors.accelerometer_bias) == pytest.approx(0.05)
    readings = [sensors.read() for _ in range(4000)]
    imu = plant.imu()
    for name, true, deviation in (
        ("gyro", imu.gyro + sensors.gyro_bias, 0.005),
        ("accelerometer", imu.accelerometer + sensors.accelerometer_bias, 0.05),
        ("joint_position", plant.data.qpos[7:], 1e-4),
        ("joint_velocity", plant.data.qvel[6:], 0.02),
        ("torque", 0.9 * plant.torque, 0.5),
    ):
        values = np.array([getattr(reading, name) for reading in readings])
        # four standard deviations of a mean, and of a deviation, over 4000
        np.testing.assert_allclose(values.mean(axis=0), true, rtol=0, atol=4.5 * deviation / np.sqrt(4000))
        np.testing.assert_allclose(values.std(axis=0), deviation, rtol=0.06)
    before = sensors.gyro_bias.copy()
    standing.advance(0.5)
    sensors.read()
    assert np.linalg.norm(sensors.gyro_bias - before) == pytest.approx(0.05, rel=1e-6)
    rest = Sensors(plant, NO_ERRORS, np.random.default_rng(0)).read_at_rest()
    np.testing.assert_array_equal(rest.gyro, 0.0)
    assert np.linalg.norm(rest.accelerometer) == pytest.approx(9.81)


# --- a gyro whose bias jumps


@pytest.mark.parametrize("name", BiasDoubt.__slots__)
def test_a_doubt_that_is_none_is_refused_by_name(name: str) -> None:
    with pytest.raises(ConfigError, match=f"bias doubt {name}"):
        BiasDoubt(**{name: 0.0})


def test_soles_that_turn_are_averaged_as_a_first_order_lag_in_the_axes_of_the_imu() -> None:
    watch = BiasWatch(BiasDoubt(rate=0.04, memory=0.4))
    rng = np.random.default_rng(0)
    turns = np.stack([pin.exp3(rng.normal(size=3)) for _ in range(2)])
    rate = np.array([0.01, -0.02, 0.03])
    rates = np.stack([turns[0].T @ rate, turns[1].T @ (2.0 * rate)])
    for n in range(1, 101):
        assert not watch.update(turns, rates, np.array([True, False]), DT)
        np.testing.assert_allclose(watch.mean, rate * (1.0 - (1.0 - DT / 0.4) ** n), rtol=1e-12, atol=1e-15)
    before = watch.mean.copy()
    watch.update(turns, rates, np.array([True, True]), DT)
    np.testing.assert_allclose(watch.mean, before + DT / 0.4 * (1.5 * rate - before), rtol=1e-12, atol=1e-15)
    assert not watch.update(turns, rates, np.array([False, False]), DT) and not watch.mean.any()


def test_what_lasts_is_doubted_after_the_time_that_the_lag_takes_and_what_rocks_is_not() -> None:
    watch, turns = BiasWatch(BiasDoubt(rate=0.04, memory=0.4)), np.stack([np.eye(3)] * 2)
    steps = next(
        n for n in range(1, 1000) if watch.update(turns, np.tile([0.0, 0.05, 0.0], (2, 1)), np.ones(2, bool), DT)
    )
    # 0.05 (1 - exp(-t/0.4)) = 0.04
    assert DT * steps == pytest.approx(0.4 * np.log(5.0), abs=3.0 * DT)
    assert watch.doubts == 1 and not watch.mean.any()
    for n in range(5000):
        rocking = 0.09 * np.sin(2.0 * np.pi * 2.0 * DT * n)
        assert not watch.update(turns, np.tile([0.0, rocking, 0.0], (2, 1)), np.ones(2, bool), DT)


@pytest.mark.parametrize("axis", range(3))
def test_a_bias_that_jumps_is_known_anew_within_seconds(robot_name: str, axis: int) -> None:
    """A step of 0.05 rad/s about any axis, of a bias that has long been known, while the robot stands: to a fifth."""
    standing = Standing(robot_name)
    plant = standing.plant
    estimator, sensors = estimator_of(plant, SensorErrors(), noise=FilterNoise(start_gyro_bias=1e-5))
    step = np.zeros(3)
    step[axis] = 0.05
    tilt = 0.0
    for n in range(2000):
        standing.advance()
        reading = sensors.read()
        state = estimator.update(replace(reading, gyro=reading.gyro + step) if n >= 250 else reading)
        up = [pin.Quaternion(s.q[3:7]).matrix()[2] for s in (state, plant.true_state())]
        tilt = max(tilt, float(np.linalg.norm(up[0] - up[1])))
        assert estimator.bias_watch.doubts == 0 or n >= 250
    assert estimator.bias_watch.doubts == 1
    assert np.linalg.norm(estimator.filter.gyro_bias - sensors.gyro_bias - step) < 0.01
    assert tilt < 0.03
