"""What is rehearsed: tasks by name, as scenarios and as words of the command line; twins in turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import UnknownNameError
from robots.mujoco_spec import PhysicalChanges
from sims.plant import PlantConfig
from sims.sensors import SensorErrors
from sims.twin.twin import TwinConfig

SECONDS = 60.0
"""Of the long tasks [s]."""


@dataclass(frozen=True, slots=True)
class RehearsedTask:
    """One task.

    Attributes:
        title: in tables.
        scenario: of the simulator, whose gait and motions it has.
        words: the same on the command line of ``safewbc deploy``.
    """

    title: str
    scenario: Scenario
    words: tuple[str, ...]


def _walk(title: str, vx: float, wz: float = 0.0) -> RehearsedTask:
    words = ("walk", "--duration", f"{SECONDS:g}", "--vx", f"{vx:g}", "--wz", f"{wz:g}")
    return RehearsedTask(title, Walk(duration=SECONDS, vx=vx, wz=wz), words)


TASKS: Mapping[str, RehearsedTask] = {
    "stand": RehearsedTask("stand", Stand(duration=SECONDS), ("stand", "--duration", f"{SECONDS:g}")),
    "hands": RehearsedTask("hand circles, ISSf", HandTracking(duration=30.0), ("hand-tracking", "--duration", "30")),
    "taichi": RehearsedTask("TAICHI", Taichi(), ("taichi",)),
    "walk": _walk("walk 0.2 m/s", 0.2),
    "turns": _walk("walk 0.15 m/s, 0.2 rad/s", 0.15, 0.2),
    "fast": _walk("walk 0.3 m/s", 0.3),
}
"""By name."""

MASS_SCALES = (1.0, 1.2, 0.9)
"""Of the twins, in turn."""

DRIFTS = (0.0, 0.003)
"""Of the gyro's bias in a minute, in turn [rad/s]."""


def task_called(name: str) -> RehearsedTask:
    """The task of a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in TASKS:
        raise UnknownNameError("task", name, list(TASKS))
    return TASKS[name]


@dataclass(frozen=True, slots=True)
class TwinVariant:
    """How a twin differs from the model.

    Attributes:
        seed: of errors and noise.
        mass_scale: factor on every mass [-].
        gyro_drift: of the gyro's bias in a minute [rad/s].
    """

    seed: int
    mass_scale: float = 1.0
    gyro_drift: float = 0.0

    def config(self) -> TwinConfig:
        """For a twin in this process."""
        plant = PlantConfig(changes=PhysicalChanges(mass_scale=self.mass_scale))
        return TwinConfig(plant, SensorErrors(gyro_drift=self.gyro_drift / 60.0), seed=self.seed)

    def words(self) -> tuple[str, ...]:
        """For a twin of its own process."""
        drift = ("--gyro-drift", f"{self.gyro_drift:g}")
        return ("--seed", f"{self.seed}", "--mass-scale", f"{self.mass_scale:g}", *drift)


def variants(seeds: int, masses: Sequence[float] = MASS_SCALES, drifts: Sequence[float] = DRIFTS) -> list[TwinVariant]:
    """One for each seed, masses and drifts in turn."""
    return [TwinVariant(i, masses[i % len(masses)], drifts[i % len(drifts)]) for i in range(seeds)]
