"""What a set of filter parameters is worth on robots and in motions that it was not tuned with."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers.whole_body.tuning_file import Tuning, read_tuning, write_tuning
from experiments.metrics.metric import Metric
from experiments.recording.recording import Recording
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.passing_sphere import Passage
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.walk import Walk
from experiments.studies.case import Case
from experiments.studies.command import command_line, study_folder
from experiments.studies.drawn_hands import DrawnHands
from experiments.studies.runs import run_case
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.study_options import RobustnessOptions
from experiments.studies.tuning_scenarios import payload, torso_targets
from robots.checks import require_between, require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot

MASS, STEP_MASS, FRICTION, PAYLOAD, DELAY = (0.8, 1.3), (0.85, 1.25), (0.0, 2.0), (0.0, 1.0), (0, 4)
"""What is drawn: factor on all masses, the same of robots that walk, factor on the joints' friction, mass in each hand
[kg], time from command to torque in whole milliseconds."""

RADIUS, SPEED, HEIGHT = (0.075, 0.11), (0.22, 0.35), (-0.04, 0.04)
"""What is drawn of the passing sphere besides the side it comes from: radius [m], speed [m/s], height above the hands
[m]."""

BEFORE: dict[str, dict[str, dict[str, float]]] = {
    robot: {
        "joint_limit": {"alpha": 10.0, "epsilon": 10.0},
        "self_collision": {"alpha": 5.0, "epsilon": 2.0},
        "leg_collision": legs,
        "obstacle": {"alpha": 5.0, "epsilon": obstacle},
        "workspace": {"alpha": 5.0, "epsilon": 5.0},
    }
    for robot, legs, obstacle in (
        ("g1", {"alpha": 5.0, "epsilon": 10.0}, 10.0),
        ("tocabi", {"alpha": 10.0, "epsilon": 15.0}, 5.0),
    )
}
"""Parameters of both robots from before they were tuned, to compare with."""

NAMES = {"adaptive": "before, adaptive", "own-adaptive": "own, adaptive"}
"""What sets of parameters are called in the table, where that is not what the option calls them."""

SCENARIOS = ("target", "circles", "cross", "obstacle", "steps")
"""What happens in a run."""

BARRIERS = ("self_collision_m", "joint_limit_rad", "obstacle_m", "workspace_m")
"""Ends of the names of the smallest barriers in a summary."""

ROBUSTNESS_COLUMNS = (
    Metric("robot", "robot"),
    Metric("scenario", "scenario"),
    Metric("parameters", "parameters"),
    Metric("runs", "runs"),
    Metric("below", "a barrier below zero", "%", 1e2),
    Metric("least_m", "least h of collision, obstacle, workspace", "mm", 1e3),
    Metric("least_rad", "of joint limits", "rad"),
    Metric("ended", "fell or was stopped", "%", 1e2),
    Metric("rmse", "hand RMSE, mean", "mm", 1e3),
    Metric("rmse_outside", "outside the conflict, mean", "mm", 1e3),
)


def draw(robot: RobotDescription, name: str, scenario: str, seed: int) -> Scenario:
    """Draw a run, but for its filter; the same robot, scenario and seed give the same one.

    Args:
        robot: the description.
        name: by which it is loaded.
        scenario: one of ``SCENARIOS``.
        seed: of the draw, and of the sensors.
    """
    # others draw from [seed], [seed, 1], [seed, 2] and [seed, 3]
    rng = np.random.default_rng([seed, 4, SCENARIOS.index(scenario)])
    plant = _draw_plant(rng, robot, STEP_MASS if scenario == "steps" else MASS)
    if scenario == "steps":
        return _draw_steps(rng, name, plant, seed)
    hands = DrawnHands(robot=name, plant=plant, seed=seed)
    if scenario == "target":
        x, y, fraction = rng.uniform(-0.03, 0.06), rng.uniform(0.0, 0.08), rng.uniform()
        heights = [target[2] for target in torso_targets(robot)]
        z = min(heights) + fraction * (max(heights) - min(heights))
        return dataclasses.replace(hands, motion="target", target=(x, y, z), duration=5.0)
    if scenario == "obstacle":
        radius, speed, height = (float(rng.uniform(*x)) for x in (RADIUS, SPEED, HEIGHT))
        passage = Passage(radius, speed, height, from_left=bool(rng.uniform() < 0.5))
        return dataclasses.replace(hands, motion="hold", obstacle=True, duration=5.0, sphere=passage)
    if scenario == "circles":
        size, period = rng.uniform(0.8, 1.2), rng.uniform(3.5, 7.0)
        return dataclasses.replace(hands, duration=8.0, circle_size=size, circle_period=period)
    left, right = rng.uniform(-0.06, 0.06, (2, 3)).tolist()
    offsets, duration = (tuple(left), tuple(right)), rng.uniform(1.0, 3.0)
    return dataclasses.replace(hands, motion="cross", duration=5.0, cross_offsets=offsets, cross_time=duration)


def _draw_plant(rng: np.random.Generator, robot: RobotDescription, masses: tuple[float, float]) -> PlantOptions:
    mass = float(rng.uniform(*masses))
    return PlantOptions(
        mass_scale=mass,
        joint_friction_scale=float(rng.uniform(*FRICTION)),
        link_mass=payload(robot, float(rng.uniform(*PAYLOAD)), mass),
        actuator_delay=1e-3 * int(rng.integers(DELAY[0], DELAY[1] + 1)),
    )


def _draw_steps(rng: np.random.Generator, name: str, plant: PlantOptions, seed: int) -> Scenario:
    if rng.uniform() < 0.5:
        return LateralSteps(robot=name, plant=plant, seed=seed, duration=9.0)
    vx, vy, wz = rng.uniform(0.0, 0.25), rng.uniform(-0.08, 0.08), rng.uniform(-0.2, 0.2)
    return Walk(robot=name, plant=plant, seed=seed, vx=vx, vy=vy, wz=wz, duration=9.0)


def robustness_row(result: Recording) -> dict[str, Any]:
    """What a run of the study is judged by, and what was drawn for it."""
    summary, scenario = result.summary, result.config["scenario"]
    least = {f"min_h_{key}": summary[f"min_h_{key}"] for key in BARRIERS}
    return {
        "below": any(h is not None and h < 0 for h in least.values()),
        **least,
        "fell": summary["fell"],
        "stop_cause": summary["stop_cause"],
        "hand_rmse_m": summary["hand_rmse_m"],
        "hand_rmse_outside_conflict_m": summary["hand_rmse_outside_conflict_m"],
        "drawn": scenario["plant"],
        "passage": scenario["sphere"] if scenario.get("obstacle") is True else None,
    }


def robustness(options: RobustnessOptions) -> int:
    """Make all runs, print the table; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robots = check_robustness(options)
    folder = study_folder(options.work.out, "robustness")
    section = Section("", robustness_cases(options, folder), ROBUSTNESS_COLUMNS, lines=summed)
    command = command_line("run robustness", options, folder)
    return print_sections([section], "robustness", robots[0].name, options.work, folder, command)


def check_robustness(options: RobustnessOptions) -> list[RobotDescription]:
    """Check every option before anything runs; returns the robots.

    Raises:
        SafeWbcError: one is not allowed.
    """
    require_between("seeds", options.seeds, 1, 100_000)
    require_between("first_seed", options.first_seed, 0, 2**31)
    require_between("jobs", options.work.jobs, 1, 64)
    for name in ("robots", "parameters", "scenarios"):
        if not getattr(options, name):
            raise ConfigError(name, (), "at least one")
    for scenario in options.scenarios:
        require_one_of("scenarios", scenario, SCENARIOS)
    robots = [load_robot(name) for name in options.robots]
    for robot in robots:
        for parameters in options.parameters:
            if parameters in {"before", "adaptive"}:
                require_one_of(f"robot of the parameters '{parameters}'", robot.name, tuple(BEFORE))
            elif parameters not in {"own", "own-adaptive"}:
                if not Path(parameters).is_file():
                    allowed = "own, own-adaptive, before, adaptive, or a file as `safewbc tune` writes it"
                    raise ConfigError("parameters", parameters, allowed)
                read_tuning(Path(parameters), robot.name)
    return robots


def robustness_cases(options: RobustnessOptions, folder: Path) -> list[Case]:
    """A case for every robot, scenario, seed and set of parameters, those that are compared one after the other."""
    cases = []
    for name in options.robots:
        robot = load_robot(name)
        sets = {p: filter_options(robot, p, folder) for p in options.parameters}
        for scenario in options.scenarios:
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                drawn = draw(robot, name, scenario, seed)
                for parameters, safety in sets.items():
                    labels = {"robot": name, "scenario": scenario, "seed": seed}
                    labels["parameters"] = NAMES.get(parameters, parameters)
                    run = dataclasses.replace(drawn, safety=safety)
                    cases.append(run_case(run, labels, None, measure=robustness_row))
    return cases


def filter_options(robot: RobotDescription, parameters: str, folder: Path) -> FilterOptions:
    """What a set of parameters means for the options of a run; files that it needs are written to ``folder``."""
    if parameters in {"own", "own-adaptive"}:
        return FilterOptions(adaptive=parameters == "own-adaptive")
    if parameters not in {"before", "adaptive"}:
        return FilterOptions(tuning=Path(parameters))
    file = folder / "parameters" / f"before-{robot.name}.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    write_tuning(file, Tuning(BEFORE[robot.name], {"robot": robot.name}))
    return FilterOptions(tuning=file, adaptive=parameters == "adaptive")


def summed(rows: Sequence[Entries]) -> list[dict[str, Any]]:
    """One line for all runs of a robot, a scenario and a set of parameters, in the order in which they came."""
    groups: dict[tuple[str, str, str], list[Entries]] = {}
    for row in rows:
        groups.setdefault((row["robot"], row["scenario"], row["parameters"]), []).append(row)
    out = []
    for (robot, scenario, parameters), group in groups.items():
        distances = [row[f"min_h_{key}"] for row in group for key in BARRIERS if not key.endswith("_rad")]
        out.append(
            {
                "robot": robot,
                "scenario": scenario,
                "parameters": parameters,
                "runs": len(group),
                "below": float(np.mean([row["below"] for row in group])),
                "least_m": _least(distances),
                "least_rad": _least([row["min_h_joint_limit_rad"] for row in group]),
                "ended": float(np.mean([bool(row["fell"] or row["stop_cause"]) for row in group])),
                "rmse": _mean([row["hand_rmse_m"] for row in group]),
                "rmse_outside": _mean([row["hand_rmse_outside_conflict_m"] for row in group]),
            }
        )
    return out


def _least(values: Sequence[float | None]) -> float | None:
    return min((v for v in values if v is not None), default=None)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None
