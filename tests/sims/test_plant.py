"""The plant: state conversion, motor law, delay, noise, and measured contact forces against Newton's law."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, MotorCommand
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant, PlantConfig, SensorNoise
from tests.support.velocities import frame_velocity

GRAVITY = 9.81
DOWN = np.array([0.0, 0.0, -GRAVITY])


def make_plant(robot: RobotDescription, seed: int = 0, **settings: Any) -> MujocoPlant:
    plant = MujocoPlant(robot, PlantConfig(**settings), np.random.default_rng(seed))
    plant.reset(standing_configuration(robot))
    return plant


def hold(robot: RobotDescription, stiffness: float = 10.0) -> MotorCommand:
    """Keep the standing posture by stiff springs: enough to stand still, whatever the gravity torques."""
    nj = len(robot.joints)
    kp, kd = stiffness * robot.joint_array("kp"), robot.joint_array("kd")
    return MotorCommand(standing_configuration(robot)[7:], np.zeros(nj), np.zeros(nj), kp, kd, 0.0)


def run(plant: MujocoPlant, seconds: float) -> None:
    for _ in range(round(seconds / plant.config.dt)):
        plant.step()


@pytest.fixture(scope="module", params=["g1", "tocabi"])
def standing(request: pytest.FixtureRequest) -> MujocoPlant:
    """A plant at rest on both feet, 20 % heavier than described, its torso shifted, its joints stiff with friction."""
    robot = load_robot(request.param)
    changes = PhysicalChanges(mass_scale=1.2, com_shift=(0.01, -0.02, 0.03), joint_friction_scale=200.0)
    plant = make_plant(robot, changes=changes)
    plant.send(hold(robot))
    run(plant, 10.0)
    return plant


def tumble(plant: MujocoPlant, rng: np.random.Generator) -> None:
    """Throw the robot into the air: base and joints turning, nothing touched."""
    q = standing_configuration(plant.robot)
    q[:3] = rng.uniform(-1, 1, 3)
    q[2] += 5.0
    quaternion = rng.standard_normal(4)
    q[3:7] = quaternion / np.linalg.norm(quaternion)
    plant.reset(q)
    plant.data.qvel[:] = rng.uniform(-1, 1, plant.model.nv)


# --- state


def test_reset_gives_the_configuration_it_was_given(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    q = standing_configuration(robot)
    q[3:7] = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    plant.reset(q)
    state = plant.true_state()
    np.testing.assert_array_equal(state.q, q)
    np.testing.assert_array_equal(state.v, 0)
    np.testing.assert_array_equal(state.tau, 0)
    assert state.stamp == 0.0
    np.testing.assert_allclose(plant.data.xmat[1].reshape(3, 3), pin.Quaternion(q[3:7]).matrix(), atol=1e-15)


def test_velocity_is_the_rate_of_the_configuration(robot: RobotDescription) -> None:
    """MuJoCo moves the configuration by the new velocity: the difference quotient is that velocity, without error."""
    plant = make_plant(robot)
    dt = plant.config.dt
    tumble(plant, np.random.default_rng(3))
    for _ in range(20):
        before = plant.true_state()
        plant.step()
        after = plant.true_state()
        r0, r1 = pin.Quaternion(before.q[3:7]).matrix(), pin.Quaternion(after.q[3:7]).matrix()
        np.testing.assert_allclose(r1 @ after.v[:3], (after.q[:3] - before.q[:3]) / dt, atol=1e-10)
        np.testing.assert_allclose(after.v[3:6], pin.log3(r0.T @ r1) / dt, atol=1e-9)
        np.testing.assert_allclose(after.v[6:], (after.q[7:] - before.q[7:]) / dt, atol=1e-10)


def test_state_means_the_same_to_pinocchio(robot: RobotDescription) -> None:
    plant, kin = make_plant(robot), Kinematics(robot)
    rng = np.random.default_rng(4)
    for _ in range(5):
        tumble(plant, rng)
        mujoco.mj_forward(plant.model, plant.data)
        mujoco.mj_subtreeVel(plant.model, plant.data)
        state = plant.true_state()
        kin.update(state.q, state.v)
        np.testing.assert_allclose(plant.center_of_mass(), kin.com, atol=1e-12)
        np.testing.assert_allclose(plant.data.subtree_linvel[1], kin.com_velocity, atol=1e-12)
        for frame in robot.frames:
            _, position = kin.frame_placement(kin.frame_id(frame.name))
            np.testing.assert_allclose(plant.frame_position(frame.name), position, atol=1e-12)


def test_states_are_copies(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    for state in (plant.true_state(), plant.measured_state()):
        state.q[:], state.v[:], state.tau[:] = np.nan, np.nan, np.nan
    run(plant, 0.01)
    assert np.isfinite(plant.true_state().q).all()
    assert np.isfinite(plant.true_state().tau).all()


def test_sole_corners_are_the_corners_of_the_contact_boxes(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    tumble(plant, np.random.default_rng(5))
    mujoco.mj_forward(plant.model, plant.data)
    corners = plant.sole_corners()
    for i, sole in enumerate(robot.soles):
        geom = plant.data.geom(f"{sole.frame}_contact")
        size = plant.model.geom(f"{sole.frame}_contact").size
        local = (corners[i] - geom.xpos) @ geom.xmat.reshape(3, 3)
        np.testing.assert_allclose(np.abs(local), np.tile(size, (4, 1)), atol=1e-12)
        np.testing.assert_allclose(local[:, 2], -size[2], atol=1e-12)
        assert len({tuple(np.sign(c)) for c in local}) == 4


# --- motors


def test_motors_follow_eq_19_at_every_physics_step(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    rng = np.random.default_rng(6)
    effort, nj = robot.joint_array("effort"), len(robot.joints)
    clipped = 0
    for _ in range(10):
        q, v = rng.uniform(-0.3, 0.3, (2, nj))
        tau = rng.uniform(-1.2, 1.2, nj) * effort
        command = MotorCommand(q, v, tau, robot.joint_array("kp"), robot.joint_array("kd"), 0.0)
        plant.send(command)
        for _ in range(3):
            state = plant.true_state()
            expected = tau + command.kp * (q - state.q[7:]) + command.kd * (v - state.v[6:])
            plant.step()
            np.testing.assert_allclose(plant.torque, np.clip(expected, -effort, effort), rtol=1e-12)
            np.testing.assert_allclose(plant.data.qfrc_actuator[6:], plant.torque, rtol=1e-12)
            np.testing.assert_array_equal(plant.true_state().tau, plant.torque)
            clipped += int((np.abs(expected) > effort).sum())
    assert 0 < clipped < 30 * nj


@pytest.mark.parametrize("delay_steps", [0, 1, 7])
def test_delay_is_a_whole_number_of_steps(robot: RobotDescription, delay_steps: int) -> None:
    """Commands that differ from step to step reach the motors so many steps later, none lost, in order."""
    plant = make_plant(robot, actuator_delay=delay_steps * 0.001)
    nj = len(robot.joints)
    zero = np.zeros(nj)
    for step in range(30):
        if step % 2 == 0:
            plant.send(MotorCommand(zero, zero, np.full(nj, 0.01 * (step + 1)), zero, zero, 0.0))
        plant.step()
        sent = 2 * ((step - delay_steps) // 2)
        np.testing.assert_array_equal(plant.torque, 0.01 * (sent + 1) if sent >= 0 else 0.0)


def test_reset_forgets_commands_and_time(robot: RobotDescription) -> None:
    """Also those that are still on their way."""
    fresh, used = make_plant(robot, actuator_delay=0.005), make_plant(robot, actuator_delay=0.005)
    used.send(hold(robot))
    run(used, 0.012)
    used.send(hold(robot))
    used.reset(standing_configuration(robot))
    for plant in (fresh, used):
        run(plant, 0.1)
    np.testing.assert_array_equal(used.true_state().q, fresh.true_state().q)
    np.testing.assert_array_equal(used.true_state().v, fresh.true_state().v)
    np.testing.assert_array_equal(used.torque, 0)
    assert used.time == fresh.time


def test_a_simulation_that_blows_up_says_so_and_stays_finite(robot: RobotDescription) -> None:
    """MuJoCo alone would silently start again from its first state, at time zero."""
    plant = make_plant(robot, dt=0.005)
    plant.send(replace(hold(robot), kd=np.full(len(robot.joints), -1e4)))
    run(plant, 3.0)
    assert plant.unstable
    assert 0 < plant.time < 3.0
    assert np.isfinite(plant.true_state().q).all()
    assert np.isfinite(plant.true_state().v).all()
    time = plant.time
    plant.step()
    assert plant.time == time
    plant.reset(standing_configuration(robot))
    plant.step()
    assert not plant.unstable


# --- noise

NOISE = SensorNoise(
    joint_position=0.01,
    joint_velocity=0.02,
    base_position=0.03,
    base_orientation=0.04,
    base_linear_velocity=0.05,
    base_angular_velocity=0.06,
)


def errors_of(plant: MujocoPlant, samples: int) -> dict[str, Array]:
    """Measured minus true, by kind."""
    true = plant.true_state()
    axes = pin.Quaternion(true.q[3:7]).matrix()
    out: dict[str, list[Array]] = {name: [] for name in SensorNoise.__slots__}
    for _ in range(samples):
        state = plant.measured_state()
        out["joint_position"].append(state.q[7:] - true.q[7:])
        out["joint_velocity"].append(state.v[6:] - true.v[6:])
        out["base_position"].append(state.q[:3] - true.q[:3])
        out["base_orientation"].append(pin.log3(axes.T @ pin.Quaternion(state.q[3:7]).matrix()))
        out["base_linear_velocity"].append(state.v[:3] - true.v[:3])
        out["base_angular_velocity"].append(state.v[3:6] - true.v[3:6])
    return {name: np.array(values) for name, values in out.items()}


def test_noise_is_white_and_has_the_deviations_asked_for(robot: RobotDescription) -> None:
    """Five standard errors of the mean, the deviation and the correlations of so many independent normal numbers."""
    samples = 2000
    plant = make_plant(robot, noise=NOISE)
    tumble(plant, np.random.default_rng(7))
    for name, error in errors_of(plant, samples).items():
        unit = error / getattr(NOISE, name)
        assert abs(unit.mean()) < 5 / np.sqrt(unit.size), name
        assert abs(unit.std() - 1) < 5 / np.sqrt(2 * unit.size), name
        following = (unit[1:] * unit[:-1]).mean()
        assert abs(following) < 5 / np.sqrt(unit.size), name
        across = unit.T @ unit / samples - np.diag((unit**2).mean(axis=0))
        assert np.abs(across).max() < 5 / np.sqrt(samples), name


def test_noise_leaves_the_quaternion_normalised_and_the_truth_alone(robot: RobotDescription) -> None:
    plant = make_plant(robot, noise=NOISE)
    before = plant.true_state()
    for _ in range(10):
        assert np.linalg.norm(plant.measured_state().q[3:7]) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(plant.true_state().q, before.q)
    np.testing.assert_array_equal(plant.true_state().v, before.v)


@pytest.mark.parametrize("kind", SensorNoise.__slots__)
def test_each_noise_touches_its_own_numbers(robot: RobotDescription, kind: str) -> None:
    plant = make_plant(robot, noise=SensorNoise(**{kind: 0.1}))
    errors = errors_of(plant, 3)
    assert np.abs(errors.pop(kind)).min() > 0
    for name, error in errors.items():
        np.testing.assert_allclose(error, 0, atol=1e-15, err_msg=name)


def test_noise_is_decided_by_the_seed(robot: RobotDescription) -> None:
    first, again, other = (make_plant(robot, seed, noise=NOISE).measured_state() for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.v, again.v)
    assert (first.q[7:] != other.q[7:]).all()


def test_without_noise_the_measured_state_is_the_true_one(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    tumble(plant, np.random.default_rng(8))
    np.testing.assert_array_equal(plant.measured_state().q, plant.true_state().q)
    np.testing.assert_array_equal(plant.measured_state().v, plant.true_state().v)


# --- mismatch


def test_mismatch_reaches_the_model_and_nothing_else() -> None:
    robot = load_robot("g1")
    nominal = make_plant(robot)
    changes = PhysicalChanges(1.2, {"torso_link": 1.5}, (0.01, 0.02, 0.03), 0.5, 2.0, 3.0)
    plant = make_plant(robot, changes=changes)
    torso = nominal.model.body("torso_link").id
    factor = np.full(nominal.model.nbody, 1.2)
    factor[torso] = 1.8
    np.testing.assert_allclose(plant.model.body_mass, factor * nominal.model.body_mass, rtol=1e-12)
    assert plant.total_mass == pytest.approx(1.2 * (robot.total_mass + 0.5 * nominal.model.body_mass[torso]), rel=1e-12)
    shift = plant.model.body_ipos - nominal.model.body_ipos
    np.testing.assert_allclose(shift[torso], [0.01, 0.02, 0.03], atol=1e-12)
    np.testing.assert_array_equal(np.delete(shift, torso, axis=0), 0)
    np.testing.assert_allclose(plant.model.dof_armature, 3 * nominal.model.dof_armature, rtol=1e-12)
    np.testing.assert_allclose(plant.model.dof_damping, 2 * nominal.model.dof_damping, rtol=1e-12)
    np.testing.assert_allclose(plant.model.dof_frictionloss, 2 * nominal.model.dof_frictionloss, rtol=1e-12)
    np.testing.assert_array_equal(plant.effort, nominal.effort)
    np.testing.assert_array_equal(plant.robot.joint_array("armature"), nominal.robot.joint_array("armature"))


# --- contact


def test_at_rest_the_ground_carries_the_whole_weight(standing: MujocoPlant) -> None:
    weight = GRAVITY * standing.total_mass
    assert np.abs(standing.true_state().v).max() < 1e-4
    forces = [
        pose[:3] @ wrench[:3] for pose, wrench in zip(standing.sole_poses, standing.contact_wrenches(), strict=True)
    ]
    np.testing.assert_allclose(sum(forces), [0, 0, weight], atol=1e-4 * weight)
    assert min(f[2] for f in forces) > 0.2 * weight


def test_at_rest_the_zmp_is_under_the_centre_of_mass(standing: MujocoPlant) -> None:
    np.testing.assert_allclose(standing.zero_moment_point(), standing.center_of_mass()[:2], atol=1e-4)


def test_at_rest_each_centre_of_pressure_lies_in_its_sole(standing: MujocoPlant) -> None:
    for sole, wrench in zip(standing.robot.soles, standing.contact_wrenches(), strict=True):
        x, y = -wrench[4] / wrench[2], wrench[3] / wrench[2]
        assert abs(x) <= sole.half_length + 1e-6
        assert abs(y) <= sole.half_width + 1e-6


def test_at_rest_the_imu_reads_gravity_upward_and_no_rate(standing: MujocoPlant) -> None:
    # sensors belong to the start of the last step, frames to its end: bring both to one instant
    mujoco.mj_forward(standing.model, standing.data)
    reading = standing.imu()
    rotation = pin.Quaternion(reading.quaternion).matrix()
    np.testing.assert_allclose(rotation @ reading.accelerometer, -DOWN, atol=1e-2)
    np.testing.assert_allclose(reading.gyro, 0, atol=1e-4)
    site = standing.robot.roles["imu"]
    np.testing.assert_allclose(rotation, standing.data.site(site).xmat.reshape(3, 3), atol=1e-12)


def test_in_free_fall_the_imu_reads_nothing_but_its_rate(robot: RobotDescription) -> None:
    """A rigid robot that turns about a point far from the IMU would read more: so it only falls, and turns not."""
    plant = make_plant(robot)
    q = standing_configuration(robot)
    q[2] = 5.0
    plant.reset(q)
    run(plant, 0.05)
    np.testing.assert_allclose(plant.imu().accelerometer, 0, atol=1e-6)
    assert (plant.contact_wrenches() == 0).all()
    assert np.isnan(plant.zero_moment_point()).all()


def test_the_gyro_reads_the_imus_angular_velocity(robot: RobotDescription) -> None:
    plant, kin = make_plant(robot), Kinematics(robot)
    tumble(plant, np.random.default_rng(9))
    mujoco.mj_forward(plant.model, plant.data)
    state = plant.true_state()
    kin.update(state.q, state.v)
    frame = kin.frame_id(robot.roles["imu"])
    rotation, _ = kin.frame_placement(frame)
    np.testing.assert_allclose(plant.imu().gyro, rotation.T @ frame_velocity(kin, frame)[3:], atol=1e-12)
    np.testing.assert_allclose(pin.Quaternion(plant.imu().quaternion).matrix(), rotation, atol=1e-12)


def momentum_balance(robot: RobotDescription, dt: float) -> tuple[Array, Array, float]:
    """Errors of linear [N s] and angular momentum about the world's origin [N m s] over 0.3 s of stamping, and impulse.

    Momentum gained must be the integral of the measured ground forces and of gravity.
    """
    plant = make_plant(robot, dt=dt, changes=PhysicalChanges(mass_scale=1.1))
    command, amplitude = hold(robot, 3.0), 0.1 * np.cos(np.arange(len(robot.joints)))
    impulse, turn = np.zeros(3), np.zeros(3)
    start = momentum(plant)
    for _ in range(round(0.3 / dt)):
        plant.send(replace(command, q=command.q + amplitude * np.sin(20 * plant.time)))
        plant.step()
        force, moment = net_load(plant)
        weight = plant.total_mass * DOWN
        impulse += dt * (force + weight)
        turn += dt * (moment + np.cross(plant.center_of_mass(), weight))
    end = momentum(plant)
    return end[0] - start[0] - impulse, end[1] - start[1] - turn, plant.total_mass * GRAVITY * 0.3


def momentum(plant: MujocoPlant) -> tuple[Array, Array]:
    data = mujoco.MjData(plant.model)
    data.qpos[:], data.qvel[:] = plant.data.qpos, plant.data.qvel
    mujoco.mj_forward(plant.model, data)
    mujoco.mj_subtreeVel(plant.model, data)
    linear = plant.total_mass * data.subtree_linvel[1]
    return linear, data.subtree_angmom[1] + np.cross(data.subtree_com[1], linear)


def net_load(plant: MujocoPlant) -> tuple[Array, Array]:
    """World force and moment about the world's origin from the wrenches in sole axes."""
    force, moment = np.zeros(3), np.zeros(3)
    for pose, wrench in zip(plant.sole_poses, plant.contact_wrenches(), strict=True):
        rotation, position = pose[:3], pose[3]
        f = rotation @ wrench[:3]
        force += f
        moment += rotation @ wrench[3:] + np.cross(position, f)
    return force, moment


def test_measured_wrenches_obey_newton_and_euler_while_moving(robot: RobotDescription) -> None:
    """What is left is the integrator's error: below a thousandth of the weight's impulse, and of first order."""
    coarse = momentum_balance(robot, 1e-3)
    fine = momentum_balance(robot, 1e-4)
    for error, small in zip(coarse[:2], fine[:2], strict=True):
        assert np.linalg.norm(error) < 1e-3 * coarse[2]
        assert np.linalg.norm(small) < 0.2 * np.linalg.norm(error)


def test_zmp_is_where_the_ground_load_has_no_tipping_moment(robot: RobotDescription) -> None:
    plant = make_plant(robot)
    command = hold(robot, 3.0)
    for k in range(200):
        plant.send(replace(command, q=command.q + 0.05 * np.sin(0.02 * k)))
        plant.step()
        force, moment = net_load(plant)
        if force[2] > 1.0:
            at_zmp = moment - np.cross([*plant.zero_moment_point(), 0.0], force)
            np.testing.assert_allclose(at_zmp[:2], 0, atol=1e-9 * plant.total_mass * GRAVITY)
    assert plant.data.ncon > 0


def test_contacts_that_carry_nothing_have_no_load(robot: RobotDescription) -> None:
    """MuJoCo lists contacts within a gap without force; here nothing else has a force either."""
    plant = make_plant(robot, changes=PhysicalChanges(joint_friction_scale=0.0))
    plant.model.geom_gap[:] = 0.01
    q = standing_configuration(robot)
    q[2] += 0.005
    plant.reset(q)
    assert plant.data.ncon > 0
    assert (plant.data.contact.efc_address < 0).all()
    np.testing.assert_array_equal(plant.contact_wrenches(), 0)
    assert np.isnan(plant.zero_moment_point()).all()


# --- refusals


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"actuator_delay": -0.001}, "actuator_delay"),
        ({"actuator_delay": float("inf")}, "actuator_delay"),
    ],
)
def test_bad_plant_settings_are_refused_by_name(settings: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        PlantConfig(**settings)
    assert caught.value.name == named
    assert repr(settings[named]) in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"mass_scale": 0.01}, "mass_scale"),
        ({"mass_scale": 11.0}, "mass_scale"),
        ({"link_mass_scale": {"pelvis": 20.0}}, "link_mass_scale of pelvis"),
        ({"sole_friction": 0.0}, "sole_friction"),
    ],
)
def test_mismatch_beyond_reason_is_refused_by_name(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        PlantConfig(changes=PhysicalChanges(**settings))
    assert caught.value.name == named


@pytest.mark.parametrize("value", [-1e-9, float("nan"), float("inf")])
@pytest.mark.parametrize("kind", SensorNoise.__slots__)
def test_bad_noise_is_refused_by_name(kind: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"noise {kind} = "):
        SensorNoise(**{kind: value})


def test_an_unknown_link_is_refused_with_the_known_ones(robot: RobotDescription) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match="tail") as caught:
        make_plant(robot, changes=PhysicalChanges(link_mass_scale={"tail": 2.0}))
    assert robot.bodies[-1].name in str(caught.value)


def test_frames_and_centre_of_mass_belong_to_the_state_just_reached(robot: RobotDescription) -> None:
    """A robot thrown through the air: positions read from the plant are those of its own configuration."""
    plant = make_plant(robot)
    tumble(plant, np.random.default_rng(3))
    kin = Kinematics(robot)
    for _ in range(5):
        plant.step()
        state = plant.true_state()
        kin.update(state.q, state.v)
        hand = robot.roles["left_hand"]
        expected = kin.frame_placement(kin.frame_id(hand))[1]
        np.testing.assert_allclose(plant.frame_position(hand), expected, rtol=0, atol=1e-10)
        np.testing.assert_allclose(plant.center_of_mass(), kin.com, rtol=0, atol=1e-10)


def test_a_new_plant_stands_at_rest(robot: RobotDescription) -> None:
    state = MujocoPlant(robot).state()
    np.testing.assert_array_equal(state.q, standing_configuration(robot))
    np.testing.assert_array_equal(state.v, np.zeros_like(state.v))


def test_noise_without_a_source_is_refused(robot: RobotDescription) -> None:
    with pytest.raises(ConfigError, match="rng"):
        MujocoPlant(robot, PlantConfig(noise=SensorNoise(joint_position=1e-3)))
