"""Options of a walk, where its obstacle stands, and its figures: known motions give known figures."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from controllers.gaits.commands import VelocityCommand
from experiments.metrics.locomotion import (
    achieved_velocity,
    swing_heights,
    touchdowns,
    velocity_errors,
    walk_metrics,
)
from experiments.running.run import commands_at, prepare
from experiments.scenarios.passing_sphere import OVERLAP, RADIUS, Beside, sphere_beside
from experiments.scenarios.pushes import PUSH_TIME, Push
from experiments.scenarios.registry import RUNNABLE, scenario_called
from experiments.scenarios.walk import Walk
from experiments.scenarios.walk_plan import FIRST, LAST, command_profile, meeting, sway
from experiments.scenarios.world import Sensor
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.pinocchio_model import standing_configuration


@pytest.mark.parametrize(
    ("options", "named", "allowed"),
    [
        (Walk(vx=1.0), "vx", "0.444"),
        (Walk(vy=-0.5), "vy", "from -"),
        (Walk(wz=math.nan), "wz", "finite"),
        (Walk(duration=4.0), "duration", "above 4 s"),
        (Walk(push=("80,up,3",)), "push", "forward, left"),
        (Walk(push=("80,left,20",), duration=20.0), "push", "within the run's 20 s"),
        (Walk(obstacle="cube"), "obstacle", "none, static, moving"),
        (Walk(obstacle="static", vy=0.05), "vx, vy, wz", "straight forward"),
        (Walk(obstacle="static", vx=0.0), "vx, vy, wz", "straight forward"),
        (Walk(obstacle="moving", duration=8.0), "duration", "passed"),
        (Walk(script=Path("nowhere.txt")), "script", "can be read"),
    ],
)
def test_refusals_name_the_option_and_what_is_allowed(options: Walk, named: str, allowed: str) -> None:
    with pytest.raises(ConfigError) as caught:
        prepare(options)
    assert named in caught.value.name
    assert allowed in str(caught.value)


def test_a_script_and_an_obstacle_do_not_go_together(tmp_path: Path) -> None:
    path = tmp_path / "walk.txt"
    path.write_text("1 0.2 0 0\n")
    prepare(Walk(script=path))
    with pytest.raises(ConfigError, match="--script"):
        prepare(Walk(script=path, obstacle="static"))


def test_a_run_begins_and_ends_standing() -> None:
    options = Walk(vx=0.1, wz=0.2, duration=9.0)
    command = command_profile(options, load_robot("g1"))
    times = np.arange(0.0, 9.0, 0.002)
    moving = commands_at(command, times).any(axis=1)
    np.testing.assert_array_equal(moving, (times > FIRST - 1e-6) & (times < 9.0 - LAST - 1e-6))
    assert command(4.0) == VelocityCommand(0.1, 0.0, 0.2, stepping=True)


def test_no_velocity_at_all_is_stepping_on_the_spot() -> None:
    command = command_profile(Walk(vx=0.0), load_robot("g1"))
    assert command(4.0) == VelocityCommand(stepping=True)
    assert not command(0.0).walks and not command(17.5).walks


def test_every_scenario_is_found_by_its_name() -> None:
    for scenario in RUNNABLE:
        assert scenario_called(scenario.name) is scenario
    with pytest.raises(UnknownNameError, match="walk"):
        scenario_called("fly")


@pytest.mark.parametrize("name", ["g1", "tocabi"])
@pytest.mark.parametrize("kind", ["static", "moving"])
def test_the_sphere_reaches_into_where_the_hand_goes(name: str, kind: str) -> None:
    robot = load_robot(name)
    place = meeting(Walk(robot=name, obstacle=kind), robot)
    motion = sphere_beside(robot, place, Sensor()).motion.motion()
    body = robot.frame(robot.roles["left_hand"]).body
    kin = Kinematics(robot)
    q = standing_configuration(robot)
    q[:2] += (place.ahead, place.sideways)
    kin.update_geometry(q)
    rotation, position = kin.frame_placement(kin.frame_id(body))
    sphere = motion.position(place.time)
    depths = []
    for shape in (c for c in robot.collisions if c.body == body):
        along = np.linspace(0.0, 1.0, 2001)[:, None]
        points = position + (shape.start + along * (shape.end - shape.start)) @ rotation.T
        depths.append(shape.radius + RADIUS - np.linalg.norm(points - sphere, axis=1).min())
    # the hand is no ball: its other parts may reach a little further in
    assert OVERLAP - 1e-9 <= max(depths) < OVERLAP + 0.002
    speed = {"static": 0.0, "moving": 0.25}[kind]
    np.testing.assert_allclose(motion.velocity(0.0), [-speed, 0.0, 0.0])
    travelled = motion.position(place.time) - motion.position(0.0)
    np.testing.assert_allclose(travelled, [-speed * place.time, 0.0, 0.0], atol=1e-12)


@given(st.integers(0, 30_000), st.sampled_from((2.5e-4, 5e-4, 1e-3)))
def test_a_push_gives_its_whole_impulse_whenever_it_begins(start: int, dt: float) -> None:
    """On a clock that adds up its steps, as a simulator's does: neither a step short nor one too many."""
    push = Push(60.0, 30.0, 1e-3 * start)
    times = np.cumsum(np.full(round((push.time + 0.2) / dt), dt)) - dt
    near = times[(times > push.time - 0.05) & (times < push.time + 0.15)]
    impulse = dt * sum(push.at(float(t)) for t in near)
    expected = 60.0 * PUSH_TIME * np.array([math.cos(math.pi / 6), 0.5, 0.0])
    np.testing.assert_allclose(impulse, expected, rtol=1e-9, atol=1e-9)


def test_a_place_beside_the_way_is_checked() -> None:
    with pytest.raises(ConfigError, match="static, moving"):
        Beside("round", 1.0, 0.05, 5.0)
    with pytest.raises(ConfigError, match="ahead"):
        Beside("static", -1.0, 0.05, 5.0)


@pytest.mark.parametrize(("omega", "single", "double"), [(3.8, 0.6, 0.2), (3.2, 0.5, 0.3), (5.0, 0.8, 0.05)])
def test_the_sway_is_that_of_the_linear_inverted_pendulum(omega: float, single: float, double: float) -> None:
    half, quarter = 0.11, 0.5 * (single + double)

    def zmp(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return half * np.minimum(2.0 * t / double, 1.0)

    def motion(t: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.vstack([y[1], omega**2 * (y[0] - zmp(t))])

    # from the middle of double support, on the line between the feet, to the middle of single support, at rest
    mesh = np.unique(np.concatenate([np.linspace(0.0, 0.5 * double, 200), np.linspace(0.5 * double, quarter, 200)]))
    solved = solve_bvp(motion, lambda a, b: np.array([a[0], b[1]]), mesh, np.zeros((2, mesh.size)), tol=1e-8)
    assert solved.success
    assert sway(half, omega, single, double) == pytest.approx(solved.y[0, -1], abs=1e-6)


# --- figures of known motions


def constant_twist(vx: float, vy: float, wz: float, n: int = 2001, dt: float = 0.002) -> dict[str, NDArray[np.float64]]:
    """Series of a body with this velocity in its own heading, by small steps; the feet are put down in turn."""
    time, q, com = dt * np.arange(n), np.zeros((n, 7)), np.zeros((n, 3))
    yaw, parts = 0.8, 20
    for i in range(n):
        q[i, 3:7] = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        if i + 1 < n:
            com[i + 1] = com[i]
            for _ in range(parts):
                middle = yaw + 0.5 * wz * dt / parts
                c, s = math.cos(middle), math.sin(middle)
                com[i + 1, :2] += np.array([c * vx - s * vy, s * vx + c * vy]) * dt / parts
                yaw += wz * dt / parts
    contact = np.ones((n, 2))
    for start, foot in ((200, 0), (500, 1), (800, 0), (1100, 1), (1400, 0), (1700, 1)):
        contact[start : start + 200, foot] = 0.0
    return {"time": time, "q": q, "com": com, "in_contact": contact}


@pytest.mark.parametrize(
    "twist", [(0.3, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 0.5), (0.2, 0.1, -0.6), (-0.1, 0.0, 1e-9)]
)
def test_the_velocity_of_a_constant_motion_is_found(twist: tuple[float, float, float]) -> None:
    series = constant_twist(*twist)
    np.testing.assert_allclose(achieved_velocity(series, 100, 1900), twist, atol=1e-6)


def test_errors_are_those_against_the_command_over_pairs_of_steps() -> None:
    series = constant_twist(0.25, 0.02, -0.1)
    commands = np.tile([0.3, 0.0, 0.2], (2001, 1))
    errors = velocity_errors(series, commands)
    for name, size in (("x_mps", 0.05), ("y_mps", 0.02), ("wz_radps", 0.3)):
        assert errors[f"velocity_error_{name}"] == pytest.approx(size, abs=1e-6)
        head, unit = name.split("_")
        assert errors[f"velocity_error_{head}_max_{unit}"] == pytest.approx(size, abs=1e-6)


def test_a_pair_in_which_the_command_changed_does_not_count() -> None:
    series = constant_twist(0.25, 0.0, 0.0)
    landings = touchdowns(series)
    np.testing.assert_array_equal(landings, [400, 700, 1000, 1300, 1600, 1900])
    commands = np.tile([0.25, 0.0, 0.0], (2001, 1))
    commands[1500:] = 0.0
    # of the pairs from the second touchdown on, only 700 to 1300 has one command all along
    assert velocity_errors(series, commands)["velocity_error_x_mps"] == pytest.approx(0.0, abs=1e-6)
    commands[600:] = 0.0
    commands[1200:] = 0.1
    assert set(velocity_errors(series, commands).values()) == {None}


def walked() -> dict[str, NDArray[np.float64]]:
    """Six steps: each foot goes 0.1 m ahead, the left one 5 cm up, the right one 4 cm; the weight is 300 N."""
    series = constant_twist(0.0, 0.0, 0.0)
    up = 1.0 - series["in_contact"]
    soles = np.zeros((2001, 2, 3))
    soles[:, :, 0] = 0.1 / 200 * np.cumsum(up, axis=0)
    soles[:, :, 2] = up * (0.05, 0.04)
    wrench = np.zeros((2001, 2, 6))
    wrench[:, :, 2] = np.where(up > 0, 0.0, np.where(up[:, ::-1] > 0, 300.0, 150.0))
    return series | {"soles": soles, "foot_wrench": wrench}


def test_steps_are_counted_and_measured() -> None:
    figures = walk_metrics(walked())
    assert figures["steps"] == 6
    assert figures["distance_m"] == pytest.approx(0.3)
    assert figures["step_height_min_m"] == pytest.approx(0.04)
    assert "velocity_error_x_mps" not in figures


def test_a_robot_that_never_steps_has_no_steps() -> None:
    series = walked()
    series["in_contact"] = np.ones_like(series["in_contact"])
    figures = walk_metrics(series, np.zeros((2001, 3)))
    assert figures["steps"] == 0
    assert figures["distance_m"] == 0.0
    assert figures["step_height_min_m"] is None
    assert figures["velocity_error_x_mps"] is None
    assert swing_heights(series) == []


def test_a_foot_that_is_still_up_at_the_end_is_no_step() -> None:
    series = walked()
    cut = {name: values[:1750] for name, values in series.items()}
    assert walk_metrics(cut)["steps"] == 5
    assert len(swing_heights(cut)) == 5
