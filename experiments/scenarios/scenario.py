"""What a scenario is: data that decides a run, and the set-up that follows from it; nothing heavy is imported here."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import tyro

from experiments.metrics.metric import Metric
from experiments.scenarios.content import Content, from_plain
from experiments.scenarios.options import FilterOptions, PlantOptions, SensingOptions
from experiments.scenarios.pushes import Push
from experiments.scenarios.world import WorldObject
from robots.errors import ConfigError

if TYPE_CHECKING:
    from controllers.agent import MakeGait, MakeMotion
    from controllers.gaits.commands import CommandProfile
    from controllers.whole_body.task_stack import PlacedTask
    from robots.description import RobotDescription
    from robots.kinematics import Kinematics
    from robots.messages import Array
    from safety.barriers.barrier import Barrier

SCENARIO = "scenario"
"""Entry of a table that names the scenario it holds."""


@dataclass(frozen=True, slots=True)
class Setup:
    """What the controller of a run begins with, made from a scenario and its robot.

    Attributes:
        posture: name of the posture it starts from.
        hands: makes the motion of the hands; ``None``: the hands are no task.
        motions: each makes what moves other references, the targets of :meth:`Scenario.extra_tasks` say; after the
            hands.
        gait: makes what moves feet and balance; ``None``: the robot stands on both feet.
        command: velocities that the gait is asked for, recorded as ``command``.
        changes: fields of the controller's configuration that the scenario sets.
        settings: of the gait, by the names of their tables below ``[tuning]``, for the record.
        reference_motion: whether the motion that the references ask for is computed too, for comparison.
    """

    posture: str = "standing"
    hands: MakeMotion | None = None
    motions: tuple[MakeMotion, ...] = ()
    gait: MakeGait | None = None
    command: CommandProfile | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    reference_motion: bool = False


@dataclass(frozen=True)
class Runnable(Content, ABC):
    """Whatever can be run and recorded: its fields decide the run."""

    name: ClassVar[str]
    """On the command line, in files and folders."""
    metrics: ClassVar[tuple[Metric, ...]] = ()
    """Metrics that other runs do not have, declared."""

    def to_json(self) -> dict[str, Any]:
        """See :meth:`Content.to_json`; names the class besides, so that :func:`read_scenario` finds it."""
        return {SCENARIO: reference_to(type(self))} | super().to_json()

    @classmethod
    def from_json(cls, table: Any) -> Self:
        """What :meth:`to_json` gave, back.

        Raises:
            SafeWbcError: the table is of another class, or a field is unknown or not of its type.
        """
        reference, fields = split_table(table)
        if reference != reference_to(cls):
            raise ConfigError(SCENARIO, reference, reference_to(cls))
        return from_plain(cls, fields, reference)


def split_table(table: Any) -> tuple[str, dict[str, Any]]:
    """What a table that holds a scenario names, and the fields.

    Raises:
        ConfigError: it names none.
    """
    if not isinstance(table, Mapping) or SCENARIO not in table:
        raise ConfigError(SCENARIO, table, f"a table with the entry {SCENARIO!r}")
    return str(table[SCENARIO]), {k: v for k, v in table.items() if k != SCENARIO}


def reference_to(scenario: type[Runnable]) -> str:
    """What :func:`experiments.scenarios.registry.scenario_called` finds the class by.

    Its name, or ``module:Class`` from outside the project.
    """
    ours = scenario.__module__.startswith(f"{__package__}.")
    return scenario.name if ours else f"{scenario.__module__}:{scenario.__qualname__}"


@dataclass(frozen=True)
class Scenario(Runnable):
    """What happens in a run of the whole body: a frozen dataclass of options with the set-up that they mean.

    A subclass adds its options as fields, documented one by one as they are here, and says in :meth:`setup` what they
    mean. Its docstring, the fields and their documentation are its page of ``safewbc run``.
    """

    robot: str = "g1"
    """Robot: g1, tocabi, or the path of a .toml description."""
    duration: float = 10.0
    """Simulated time [s]."""
    control_rate: float = 500.0
    """Control frequency; its period must be a whole number of physics steps [Hz]."""
    seed: int = 0
    """Seed of everything random: the sensor noise of --noise-scale, the errors of the sensors behind --state and, with
    --obstacle, the noise of the obstacle's sensor [-]."""
    nan_at: float | None = None
    """Turn one measured joint position into NaN from this time on, to see the controlled stop [s]."""
    singular: str | None = None
    """What inverse kinematics does with small singular values: damped, so that velocities do not jump, or cut, as in
    the paper (docs/controller.md); the robot's own tuning if not given."""
    plant: Annotated[PlantOptions, tyro.conf.arg(name="")] = field(default_factory=PlantOptions)
    safety: Annotated[FilterOptions, tyro.conf.arg(name="")] = field(default_factory=FilterOptions)
    sensing: Annotated[SensingOptions, tyro.conf.arg(name="")] = field(default_factory=SensingOptions)
    pushes: Annotated[tuple[Push, ...], tyro.conf.Suppress] = ()
    """On the torso, beside those that options ask for."""
    world: Annotated[tuple[WorldObject, ...], tyro.conf.Suppress] = ()
    """Bodies around the robot, beside those that options ask for."""

    @abstractmethod
    def setup(self, robot: RobotDescription) -> Setup:
        """What the options mean for a robot.

        Raises:
            SafeWbcError: an option is not allowed, or the description lacks what the scenario needs.
        """

    def all_pushes(self, robot: RobotDescription) -> tuple[Push, ...]:
        """Every push of the run."""
        return self.pushes

    def objects(self, robot: RobotDescription) -> tuple[WorldObject, ...]:
        """Every body around the robot."""
        return self.world

    def mismatch(self, robot: RobotDescription) -> PlantOptions:
        """How the simulated robot differs from the controller's model."""
        return self.plant

    def extra_barriers(self, kin: Kinematics) -> Sequence[Barrier]:
        """Barriers of one's own beside the standard ones, which the safety filter keeps too."""
        return ()

    def extra_tasks(self, kin: Kinematics) -> Sequence[PlacedTask]:
        """Tasks of one's own among the standard ones; ``Setup.motions`` set their targets."""
        return ()

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """What ``metrics`` declare, from the recorded series."""
        return {}

    def is_random(self, robot: RobotDescription) -> bool:
        """Whether anything depends on the seed."""
        seen = any(o.sensor is not None and o.sensor.noise > 0 for o in self.objects(robot))
        return seen or self.mismatch(robot).noise_scale > 0 or self.sensing.state != "true"

    def to_json(self) -> dict[str, Any]:
        """See :meth:`Runnable.to_json`; a robot given by its file is named by the absolute path."""
        robot = str(Path(self.robot).resolve()) if self._robot_file() else self.robot
        return super().to_json() | {"robot": robot}

    def files(self) -> list[Path]:
        """See :meth:`Content.files`."""
        return [*super().files(), *self._robot_file()]

    def _robot_file(self) -> list[Path]:
        return [Path(self.robot)] if self.robot.endswith(".toml") else []
