"""Walks in which everything is drawn from a seed: the robot's masses, the ground, sensors, commands, pushes."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from controllers.gaits.commands import CommandScript, VelocityCommand
from experiments.cli.console import results_folder
from experiments.metrics.metric import Figure, column
from experiments.recording.recording import RunResult
from experiments.running.pool import Row, Task, in_parallel, row, save
from experiments.running.run import check_options, run
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions, PlantOptions
from experiments.scenarios.scenario import PUSH_TIME, Push, Series
from experiments.scenarios.walk import walk_scenario, with_commands
from experiments.studies.results_tables import markdown
from experiments.studies.study_options import RandomWalkOptions, RandomWalksOptions
from robots.checks import require_between
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot

MASS, LINK_MASS = (0.85, 1.25), (0.9, 1.1)
"""Factor on all masses, and on each body's own besides."""

FRICTION, NOISE = (0.5, 1.0), (0.5, 1.0)
"""Friction of soles and ground; sensor noise as a share of the standard one."""

DELAY = (2, 4)
"""Time from command to torque, whole milliseconds: physics steps."""

FASTEST = VelocityCommand(0.3, 0.1, 0.3)
"""Largest commands."""

CHANGE = (2.0, 5.0)
"""Time from one command to the next [s]."""

START = 1.0
"""When the first command comes [s]."""

STOP, STEP = 0.15, 0.15
"""Shares of the commands that are to stop, and to step on the spot."""

PUSHES, PUSH = (1, 3), (0.03, 0.1)
"""How many pushes, and their impulse per mass of the simulated robot [N s/kg]."""

SHORTEST = 6.0
"""Shortest walk [s]: pushes come from ``START`` plus a second on, one a second at most."""

RANDOM_WALK_COLUMNS = (
    Figure("seed", "seed"),
    Figure("ended", "fell"),
    Figure("drawn_mass", "mass"),
    Figure("drawn_links", "links' factor"),
    Figure("drawn_friction", "friction"),
    Figure("drawn_noise", "noise"),
    Figure("drawn_delay_ms", "delay", "ms"),
    Figure("drawn_commands", "commands"),
    Figure("drawn_pushes", "pushes, N s/kg"),
    column("zmp_inside_fraction", "ZMP inside"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("qp_failures", "QP failures"),
)


@dataclass(frozen=True, slots=True)
class RandomWalk:
    """What was drawn.

    Attributes:
        plant: the simulated robot and the ground.
        script: the commands.
        pushes: on the torso.
        impulses: of the pushes, per mass of the simulated robot [N s/kg].
    """

    plant: PlantOptions
    script: CommandScript
    pushes: tuple[Push, ...]
    impulses: tuple[float, ...]


def draw_walk(robot: RobotDescription, seed: int, duration: float) -> RandomWalk:
    """Draw a walk of ``duration`` [s]; the same seed, robot and duration give the same walk."""
    # the plant's noise has default_rng(seed) and an obstacle's sensor has [seed, 1]
    rng = np.random.default_rng([seed, 2])
    plant = PlantOptions(
        mass_scale=float(rng.uniform(*MASS)),
        link_mass={body.name: float(rng.uniform(*LINK_MASS)) for body in robot.bodies},
        friction=float(rng.uniform(*FRICTION)),
        actuator_delay=1e-3 * int(rng.integers(DELAY[0], DELAY[1] + 1)),
        noise_scale=float(rng.uniform(*NOISE)),
    )
    script = _draw_script(rng, duration)
    impulses = tuple(float(x) for x in rng.uniform(*PUSH, int(rng.integers(PUSHES[0], PUSHES[1] + 1))))
    forces = [impulse * true_mass(robot, plant) / PUSH_TIME for impulse in impulses]
    pushes = tuple(
        Push(force, float(rng.uniform(0.0, 360.0)), _draw_time(rng, i, len(forces), duration))
        for i, force in enumerate(forces)
    )
    return RandomWalk(plant, script, pushes, impulses)


def _draw_script(rng: np.random.Generator, duration: float) -> CommandScript:
    times, commands = [], []
    t = START
    while t < duration:
        times.append(t)
        commands.append(_draw_command(rng))
        t += float(rng.uniform(*CHANGE))
    return CommandScript(times, commands)


def _draw_command(rng: np.random.Generator) -> VelocityCommand:
    kind = rng.uniform()
    vx, vy, wz = (float(rng.uniform(-top, top)) for top in (FASTEST.vx, FASTEST.vy, FASTEST.wz))
    if kind < STOP:
        return VelocityCommand()
    return VelocityCommand(stepping=True) if kind < STOP + STEP else VelocityCommand(vx, vy, wz)


def _draw_time(rng: np.random.Generator, index: int, count: int, duration: float) -> float:
    """A time in one of ``count`` equal parts of the walk, at least a second before the next part [s]."""
    first, length = START + 1.0, (duration - START - 1.0) / count
    return float(rng.uniform(first + index * length, first + (index + 1) * length - 1.0))


def true_mass(robot: RobotDescription, plant: PlantOptions) -> float:
    """Mass of the simulated robot [kg]."""
    return plant.mass_scale * sum(body.mass * plant.link_mass.get(body.name, 1.0) for body in robot.bodies)


def check_random_walk(options: RandomWalkOptions) -> RobotDescription:
    """Check every option before anything is made or written; returns the robot.

    Raises:
        SafeWbcError: an option is not allowed.
    """
    if options.plant != PlantOptions():
        raise ConfigError("plant", options.plant, "left as it is: it is drawn from the seed")
    require_between("duration", options.duration, SHORTEST, 600.0)
    return check_options(options)


def run_random_walk(options: RandomWalkOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Walk as drawn from ``options.seed``; see :func:`experiments.running.run.run`.

    What was drawn stands in the configuration under ``drawn``, and in figures whose names begin with it.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robot = check_random_walk(options)
    drawn = draw_walk(robot, options.seed, options.duration)
    scenario = walk_scenario(robot, drawn.script)
    walked = scenario.figures

    def figures(robot: RobotDescription, series: Series) -> dict[str, Any]:
        return (walked(robot, series) if walked else {}) | drawn_figures(robot, drawn)

    scenario = dataclasses.replace(scenario, experiment="random-walk", pushes=drawn.pushes, figures=figures)
    result = with_commands(run(scenario, dataclasses.replace(options, plant=drawn.plant), progress), drawn.script)
    # the options as they were given: with them the run can be made again
    given = dataclasses.asdict(options)
    given.pop("output")
    commands = [[t, dataclasses.asdict(c)] for t, c in zip(drawn.script.times, drawn.script.commands, strict=True)]
    told = {"commands": commands, "pushes": [dataclasses.asdict(push) for push in drawn.pushes]}
    return dataclasses.replace(result, config={**result.config, "options": given, "drawn": told})


def drawn_figures(robot: RobotDescription, drawn: RandomWalk) -> dict[str, Any]:
    """What was drawn, for the summary."""
    return {
        "drawn_mass": drawn.plant.mass_scale,
        "drawn_links": true_mass(robot, drawn.plant) / (drawn.plant.mass_scale * robot.total_mass),
        "drawn_friction": drawn.plant.friction,
        "drawn_noise": drawn.plant.noise_scale,
        "drawn_delay_ms": 1e3 * drawn.plant.actuator_delay,
        "drawn_commands": len(drawn.script.times),
        "drawn_pushes": ", ".join(f"{impulse:.2f}" for impulse in drawn.impulses),
    }


def random_walks(options: RandomWalksOptions) -> int:
    """Run them all, print who falls and what was drawn, save configuration and summary of each; returns 0.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    check_random_walks(options)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    with results_folder(OutputOptions(out=options.out), "random-walks") as folder:
        warm_up(console, load_robot(options.robot))
        rows = list(in_parallel(random_walk_tasks(options, folder), options.jobs, console))
    print(f"{markdown(rows, RANDOM_WALK_COLUMNS)}\n\n{falls(rows)}")
    console.print(f"runs: {folder}")
    return 0


def check_random_walks(options: RandomWalksOptions) -> None:
    """Check every option before anything runs.

    Raises:
        SafeWbcError: one is not allowed.
    """
    require_between("runs", options.runs, 1, 100_000)
    require_between("jobs", options.jobs, 1, 64)
    check_random_walk(_one(options, options.first_seed))


def _one(options: RandomWalksOptions, seed: int) -> RandomWalkOptions:
    return RandomWalkOptions(robot=options.robot, duration=options.duration, seed=seed)


def random_walk_tasks(options: RandomWalksOptions, folder: Path) -> list[Task]:
    """A task for each seed."""
    seeds = range(options.first_seed, options.first_seed + options.runs)
    return [partial(random_walk_row, _one(options, seed), folder / f"random-walk-{seed}") for seed in seeds]


def random_walk_row(options: RandomWalkOptions, folder: Path) -> Row:
    """Run one, save its configuration and summary, return its line."""
    start = time.process_time()
    result = run_random_walk(options)
    save(result, folder, series=False)
    return row(result) | {"cpu_s": time.process_time() - start}


def falls(rows: Sequence[Row]) -> str:
    """Who fell or was stopped, in a sentence."""
    down = [r for r in rows if r["ended"] != "no"]
    named = ", ".join(f"{r['seed']} ({r['ended']})" for r in down)
    share = f"{len(down)} of {len(rows)} fell or were stopped ({100 * len(down) / len(rows):.3g} %)"
    return share + (f": seed {named}." if down else ".")
