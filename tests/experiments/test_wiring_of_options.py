"""Every option of a run reaches controller and plant, and what is recorded as true is true."""

from dataclasses import fields, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.random import default_rng

from controllers.obstacle_tracker import ObstacleTracker
from controllers.whole_body.robot_config import controller_config
from experiments.running.run import prepare, run
from experiments.running.world import World
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.passing_sphere import Passage, passing_sphere
from experiments.scenarios.resolve import STANDARD_NOISE, control_config, plant_config
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.world import VELOCITIES, Sensor
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, MotorCommand
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.geometry.shapes import Obstacle
from safety.tracking import ObstacleTrack, TrackerSettings
from sims.obstacles import PositionSensor
from sims.plant import MujocoPlant, PlantConfig, SensorNoise

# --- controller


@pytest.mark.parametrize("name", ["alpha", "epsilon"])
def test_alpha_and_epsilon_are_those_of_self_collision(robot: RobotDescription, name: str) -> None:
    """Each sets its own, and nothing else of the robot's tuning."""
    plain = control_config(robot, Stand())
    assert plain == controller_config(robot)
    config = control_config(robot, Stand(safety=FilterOptions(**{name: 17.5})))
    pairs = plain.safety.self_collision
    assert getattr(pairs, name) != 17.5
    assert config == replace(plain, safety=replace(plain.safety, self_collision=replace(pairs, **{name: 17.5})))


def test_both_at_once_and_the_filter_s_name(robot: RobotDescription) -> None:
    config = control_config(robot, Stand(safety=FilterOptions("issf", alpha=3.25, epsilon=0.75)))
    assert (config.safety.self_collision.alpha, config.safety.self_collision.epsilon) == (3.25, 0.75)
    assert config.filter == "issf"


def test_what_is_done_with_small_singular_values(robot: RobotDescription) -> None:
    plain = control_config(robot, Stand())
    assert plain.tasks.singular == "damped"
    assert control_config(robot, Stand(singular="cut")) == replace(plain, tasks=replace(plain.tasks, singular="cut"))
    with pytest.raises(ConfigError, match="singular"):
        control_config(robot, Stand(singular="ignored"))


@pytest.mark.parametrize("rate", [200.0, 250.0, 1000.0])
def test_the_control_rate_sets_the_period(robot: RobotDescription, rate: float) -> None:
    assert control_config(robot, Stand(control_rate=rate)).dt == pytest.approx(1 / rate, rel=1e-12)


# --- plant


def plant_of(robot: RobotDescription, rng: np.random.Generator | None = None, **options: Any) -> MujocoPlant:
    plant = MujocoPlant(robot, plant_config(PlantOptions(**options)), rng or np.random.default_rng(0))
    plant.reset(standing_configuration(robot))
    return plant


def torso_of(robot: RobotDescription) -> str:
    return robot.frame(robot.roles["torso"]).body


def test_every_plant_option_reaches_the_plant_s_configuration() -> None:
    options = PlantOptions(
        mass_scale=1.1,
        link_mass={"torso_link": 1.3},
        com_shift=(0.01, -0.02, 0.03),
        friction=0.45,
        joint_friction_scale=1.7,
        armature_scale=0.6,
        actuator_delay=0.004,
        noise_scale=2.5,
        physics_dt=0.0005,
    )
    defaults = PlantOptions()
    assert all(getattr(options, f.name) != getattr(defaults, f.name) for f in fields(PlantOptions))
    config = plant_config(options)
    assert config.changes == PhysicalChanges(
        mass_scale=1.1,
        link_mass_scale={"torso_link": 1.3},
        com_shift=(0.01, -0.02, 0.03),
        sole_friction=0.45,
        joint_friction_scale=1.7,
        armature_scale=0.6,
    )
    assert (config.dt, config.actuator_delay) == (0.0005, 0.004)
    for f in fields(SensorNoise):
        standard = getattr(STANDARD_NOISE, f.name)
        assert standard > 0
        assert getattr(config.noise, f.name) == pytest.approx(2.5 * standard, rel=1e-12)
    assert plant_config(defaults) == PlantConfig()


def test_masses_reach_the_compiled_model(robot: RobotDescription) -> None:
    torso = torso_of(robot)
    plain, changed = plant_of(robot).model, plant_of(robot, mass_scale=1.1, link_mass={torso: 1.3}).model
    scale = np.full(plain.nbody, 1.1)
    scale[mujoco.mj_name2id(plain, mujoco.mjtObj.mjOBJ_BODY, torso)] *= 1.3
    np.testing.assert_allclose(changed.body_mass, scale * plain.body_mass, rtol=1e-12)
    np.testing.assert_allclose(changed.body_inertia, scale[:, None] * plain.body_inertia, rtol=1e-9)


def test_the_com_shift_reaches_the_compiled_model(robot: RobotDescription) -> None:
    shift = (0.01, -0.02, 0.03)
    plain, changed = plant_of(robot).model, plant_of(robot, com_shift=shift).model
    expected = np.zeros((plain.nbody, 3))
    expected[mujoco.mj_name2id(plain, mujoco.mjtObj.mjOBJ_BODY, torso_of(robot))] = shift
    np.testing.assert_allclose(changed.body_ipos - plain.body_ipos, expected, rtol=0, atol=1e-12)


def test_friction_reaches_floor_and_soles(robot: RobotDescription) -> None:
    model = plant_of(robot, friction=0.45).model
    for name in ("floor", *(f"{s.frame}_contact" for s in robot.soles)):
        assert model.geom(name).friction[0] == pytest.approx(0.45)


def test_the_joints_friction_and_armature_reach_the_compiled_model(robot: RobotDescription) -> None:
    plain = plant_of(robot).model
    rough, light = (plant_of(robot, **{n: 0.3}).model for n in ("joint_friction_scale", "armature_scale"))
    assert plain.dof_armature[6:].min() > 0
    assert plain.dof_damping.max() + plain.dof_frictionloss.max() > 0
    for name, scaled, other in (
        ("dof_damping", rough, light),
        ("dof_frictionloss", rough, light),
        ("dof_armature", light, rough),
    ):
        np.testing.assert_allclose(getattr(scaled, name), 0.3 * getattr(plain, name), rtol=1e-12)
        np.testing.assert_array_equal(getattr(other, name), getattr(plain, name))


def test_the_physics_step_reaches_the_simulation(robot: RobotDescription) -> None:
    plant = plant_of(robot, physics_dt=0.0005)
    assert plant.model.opt.timestep == 0.0005
    for _ in range(4):
        plant.step()
    assert plant.time == pytest.approx(0.002)


@pytest.mark.parametrize(("delay", "steps"), [(0.0, 0), (0.003, 6), (0.005, 10)])
def test_torques_come_after_the_actuator_delay(robot: RobotDescription, delay: float, steps: int) -> None:
    plant = plant_of(robot, physics_dt=0.0005, actuator_delay=delay)
    zero = np.zeros(len(robot.joints))
    plant.send(MotorCommand(zero, zero, zero + 1.0, zero, zero, 0.0))
    for _ in range(steps):
        plant.step()
        np.testing.assert_array_equal(plant.torque, 0.0)
    plant.step()
    np.testing.assert_array_equal(plant.torque, 1.0)


def test_the_noise_scale_scales_every_measurement(robot: RobotDescription) -> None:
    """The same random numbers: deviations of position and velocity are in proportion, zero without noise."""

    def deviation(scale: float) -> tuple[Array, Array]:
        plant = plant_of(robot, rng=np.random.default_rng(5), noise_scale=scale)
        true, measured = plant.true_state(), plant.measured_state()
        # the base's orientation turns: to first order only in proportion
        return np.delete(measured.q - true.q, slice(3, 7)), measured.v - true.v

    for none, once, thrice in zip(deviation(0.0), deviation(1.0), deviation(3.0), strict=True):
        np.testing.assert_array_equal(none, 0.0)
        assert (once != 0.0).all()
        np.testing.assert_allclose(thrice, 3.0 * once, rtol=0, atol=1e-14)


# --- obstacle

SENSED = np.arange(0.0, 0.4, 0.002)
"""Ticks over which the obstacle is seen [s]."""


def encountered(**seen: Any) -> tuple[World, Obstacle, ObstacleTrack]:
    """A world with the passing sphere, what is believed of it at the last tick, a track of the same measurements."""
    sensor = Sensor(**seen)
    sphere = passing_sphere(load_robot("g1"), Passage(), sensor)
    world = World([sphere], seed=3)
    tracker, twin = ObstacleTracker(world.tracking()), PositionSensor(sensor.rate, sensor.noise, default_rng([3, 1]))
    track = ObstacleTrack(TrackerSettings(position_noise=sensor.noise))
    for t in SENSED:
        for detection in world.detections(t):
            tracker.observe(detection)
        assert not tracker.faults(t)
        track.measure(twin.measure(sphere.motion.motion().position(t), t), t)
    (believed,) = tracker.obstacles(SENSED[-1]).values()
    return world, believed, track


@pytest.mark.parametrize("kappa", [0.0, 2.5])
@pytest.mark.parametrize("velocity", VELOCITIES)
def test_what_is_believed_of_the_obstacle_follows_the_options(velocity: str, kappa: float) -> None:
    """Its place is always that of the track; its radius grows by kappa sigma, its velocity is what was asked for."""
    world, believed, track = encountered(velocity=velocity, kappa=kappa, rate=40.0, noise=0.008)
    t = float(SENSED[-1])
    position, estimated = track.estimate(t)
    (real,) = world.true(t)
    np.testing.assert_allclose(believed.position, position, rtol=0, atol=1e-12)
    assert believed.radius == pytest.approx(real.radius + kappa * track.position_sigma(t), rel=1e-12)
    expected = {"zero": np.zeros(3), "true": real.velocity, "estimated": estimated}[velocity]
    np.testing.assert_allclose(believed.velocity, expected, rtol=0, atol=1e-12)
    assert np.linalg.norm(estimated - real.velocity) > 1e-3


def test_every_option_of_the_obstacle_reaches_its_sensor() -> None:
    given = {"rate": 45.0, "noise": 0.007, "lost_at": 1.5, "velocity": "true", "kappa": 2.0}
    robot = load_robot("g1")
    scenario = HandTracking(obstacle=True, **{f"obstacle_{name}": value for name, value in given.items()})
    assert [o.sensor for o in scenario.objects(robot)] == [Sensor(**given)]
    assert [o.sensor for o in HandTracking(obstacle=True).objects(robot)] == [Sensor()]
    assert HandTracking().objects(robot) == ()


# --- runs


def test_a_run_uses_its_options() -> None:
    """Plant, controller and random numbers of a run are made from its options, not from defaults."""
    scenario = Stand(
        duration=0.1,
        control_rate=250.0,
        seed=11,
        plant=PlantOptions(mass_scale=1.05, friction=0.7, noise_scale=0.5, physics_dt=0.002),
        safety=FilterOptions("issf", alpha=3.25, epsilon=0.75),
    )
    result = run(scenario)
    given = prepare(scenario)
    assert given.plant == plant_config(scenario.plant)
    assert given.control == control_config(load_robot("g1"), scenario)
    assert result.config["plant"]["changes"]["mass_scale"] == 1.05
    assert result.config["controller"]["safety"]["self_collision"]["alpha"] == 3.25
    np.testing.assert_allclose(np.diff(result.series["time"]), 0.004, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diff(result.series["step_time"]), 0.002, rtol=0, atol=1e-12)
    # the noise is the seed's: nothing else of the two runs differs
    other = run(replace(scenario, seed=12)).series["v_des"]
    assert np.abs(other - result.series["v_des"]).max() > 0.0
    np.testing.assert_array_equal(run(scenario).series["v_des"], result.series["v_des"])


@pytest.mark.parametrize(
    ("scenario", "name"),
    [
        (Stand(safety=FilterOptions("ssa", alpha=3.0)), "alpha"),
        (Stand(safety=FilterOptions("none", alpha=3.0)), "alpha"),
        (Stand(safety=FilterOptions("ssa", epsilon=3.0)), "epsilon"),
        (Stand(safety=FilterOptions("cbf", epsilon=3.0)), "epsilon"),
        (Stand(safety=FilterOptions("issf", layer=0.01)), "layer"),
        (HandTracking(obstacle_noise=0.01), "obstacle_noise"),
        (HandTracking(obstacle_lost_at=1.0), "obstacle_lost_at"),
        (HandTracking(target=(0.1, 0.0, 0.0)), "target"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_an_option_without_effect_is_refused(scenario: Scenario, name: str) -> None:
    with pytest.raises(ConfigError, match=f"^{name} = .*left out with"):
        prepare(scenario)


def test_what_a_seed_is_for_is_told(robot: RobotDescription) -> None:
    assert not Stand().is_random(robot)
    assert not HandTracking(obstacle=True, obstacle_noise=0.0).is_random(robot)
    assert Stand(plant=PlantOptions(noise_scale=0.1)).is_random(robot)
    assert HandTracking(obstacle=True).is_random(robot)
    assert run(Stand(duration=0.1, seed=5)).summary["seed"] is None


def test_recorded_barriers_are_those_of_the_true_state(robot_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With strong noise on what the controller sees, values at tick instants are those of the plant's own state."""
    simulated: list[Array] = []
    send = MujocoPlant.send

    def spy(self: MujocoPlant, command: MotorCommand) -> None:
        simulated.append(self.data.qpos.copy())
        send(self, command)

    monkeypatch.setattr(MujocoPlant, "send", spy)
    options = HandTracking(robot=robot_name, duration=0.3, plant=PlantOptions(noise_scale=3.0))
    series = run(options).series
    qpos = np.array(simulated)
    assert len(qpos) == len(series["time"]) == 150
    # MuJoCo's quaternion is w, x, y, z
    np.testing.assert_array_equal(series["q"], qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]])
    kin = Kinematics(load_robot(robot_name))
    barriers = standard_barriers(kin)
    cut = barriers.slices
    for i in range(1, 150):
        kin.update(series["q"][i], np.zeros(kin.nv))
        h = barriers.evaluate(kin).h
        step = 2 * i - 1
        assert series["step_time"][step] == pytest.approx(series["time"][i], abs=1e-9)
        distances = h[[*barriers.representative["self_collision"], *barriers.representative["leg_collision"]]]
        np.testing.assert_allclose(series["h_self_collision"][step], distances, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(series["h_joint_limit"][step], h[cut["joint_limit"]].min(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(series["h_workspace"][step], h[cut["workspace"]], rtol=0, atol=1e-12)
