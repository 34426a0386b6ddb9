"""What a random walk draws from its seed."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.gaits.commands import CommandScript, VelocityCommand
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.pushes import PUSH_TIME, Push
from robots.description import RobotDescription

MASS, LINK_MASS = (0.85, 1.25), (0.9, 1.1)
"""Factor on all masses, and on each body's own besides."""

FRICTION, NOISE = (0.5, 1.0), (0.5, 1.0)
"""Friction of soles and ground; sensor noise as a fraction of the standard one."""

DELAY = (2, 4)
"""Time from command to torque, whole milliseconds: physics steps."""

FASTEST = VelocityCommand(0.3, 0.1, 0.3)
"""Largest commands."""

CHANGE = (2.0, 5.0)
"""Time from one command to the next [s]."""

START = 1.0
"""When the first command comes [s]."""

STOP, STEP = 0.15, 0.15
"""Fractions of the commands that are to stop, and to step on the spot."""

PUSHES, PUSH = (1, 3), (0.03, 0.1)
"""How many pushes, and their impulse per mass of the simulated robot [N s/kg]."""


@dataclass(frozen=True, slots=True)
class RandomDraw:
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


def draw_walk(robot: RobotDescription, seed: int, duration: float) -> RandomDraw:
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
    return RandomDraw(plant, script, pushes, impulses)


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


def drawn_metrics(robot: RobotDescription, drawn: RandomDraw) -> dict[str, Any]:
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
