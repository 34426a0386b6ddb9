"""The runs that the safety filter's parameters are tuned with: scenarios, on robots at the edges of what is allowed."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies.study_options import TuneOptions
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.barriers.rows import FAMILIES

ARMS = ("self_collision", "joint_limit")
"""Families that runs of the hands measure."""

LEG_MASSES, LEG_DELAY = (0.9, 1.2), 0.002
"""Walking robots: heavier ones and longer delays make the gait fall whatever the filter does [-, s]."""


@dataclass(frozen=True, slots=True)
class TuningRun:
    """One run.

    Attributes:
        name: scenario and robot, in words.
        families: that it measures.
        options: of the run, but for the parameters of its filter.
    """

    name: str
    families: tuple[str, ...]
    options: Scenario

    def with_parameters(self, file: Path) -> Scenario:
        """The run with the parameters of a file."""
        return dataclasses.replace(self.options, safety=FilterOptions(tuning=file))


def payload(robot: RobotDescription, mass: float, mass_scale: float = 1.0) -> dict[str, float]:
    """Factors on the hands' bodies that add ``mass`` [kg] to each, where all masses are scaled as well."""
    masses = {b.name: b.mass for b in robot.bodies}
    hands = {robot.frame(robot.roles[role]).body for role in ("left_hand", "right_hand")}
    return {hand: 1.0 + mass / (mass_scale * masses[hand]) for hand in sorted(hands)} if mass > 0 else {}


def corner_plants(robot: RobotDescription, options: TuneOptions) -> dict[str, PlantOptions]:
    """Robots at the edges of what is to be withstood: light without friction, heavy with it, loaded without and with.

    Friction holds a load as well as it keeps a joint from following: either may be the worse.
    """
    (light, heavy), (least, most) = options.masses, options.joint_friction
    plants = {
        "light": PlantOptions(mass_scale=light, joint_friction_scale=least),
        "heavy": PlantOptions(mass_scale=heavy, joint_friction_scale=most, actuator_delay=options.delay),
    }
    if options.payload > 0:
        load = payload(robot, options.payload, heavy)
        plants["loaded"] = dataclasses.replace(plants["heavy"], joint_friction_scale=least, link_mass=load)
        plants["loaded, stiff"] = dataclasses.replace(plants["heavy"], link_mass=load)
        light_load = payload(robot, options.payload, light)
        plants["light, loaded, stiff"] = dataclasses.replace(
            plants["loaded, stiff"], mass_scale=light, link_mass=light_load
        )
    return plants


def torso_targets(robot: RobotDescription) -> list[tuple[float, float, float]]:
    """Places for the left hand in each collision body of the torso that it may hit, from the torso's frame [m].

    A little to the hand's own side, so that the two hands do not meet first.
    """
    torso = robot.frame(robot.roles["torso"])
    hands = {c.name for c in robot.collisions if c.body == robot.frame(robot.roles["left_hand"]).body}
    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot, "standing"))
    origin = kin.frame_placement(kin.frame_id(robot.roles["torso"]))[1]
    rotation, position = kin.frame_placement(kin.frame_id(torso.body))
    partners = {name for pair in robot.self_collision_pairs if hands & set(pair) for name in pair}
    shapes = [c for c in robot.collisions if c.body == torso.body and c.name in partners]
    centres = [position + rotation @ (0.5 * (np.asarray(c.start) + np.asarray(c.end))) - origin for c in shapes]
    return [(float(c[0]), 0.03, float(c[2])) for c in centres]


def posture_ratios(robot: RobotDescription) -> dict[str, float]:
    """Largest squared gradient over barrier of any row of each family in any of the robot's postures.

    Over alpha it is the epsilon below which the filter would push the robot out of a posture of its own: the room kept
    at rest would be larger than the distance there is.
    """
    kin = Kinematics(robot)
    barriers = standard_barriers(kin)
    ratios = dict.fromkeys(FAMILIES, 0.0)
    for posture in robot.postures:
        kin.update_geometry(standing_configuration(robot, posture))
        rows = barriers.evaluate(kin)
        ratio = np.divide(np.vecdot(rows.jac, rows.jac), rows.h, out=np.zeros_like(rows.h), where=rows.h > 0)
        for i, family in enumerate(FAMILIES):
            ratios[family] = max(ratios[family], float(ratio[rows.family == i].max(initial=0.0)))
    return ratios


def tuning_runs(robot: RobotDescription, options: TuneOptions) -> list[TuningRun]:
    """All runs of a round; also those that the robot's description lacks something for."""
    runs = []
    for name, plant in corner_plants(robot, options).items():
        hands = HandTracking(robot=options.robot, plant=plant)
        for motion, duration in (("circles", 5.5), ("cross", 4.0)):
            run = dataclasses.replace(hands, motion=motion, duration=duration)
            runs.append(TuningRun(f"{motion}, {name}", ARMS, run))
        for i, target in enumerate(torso_targets(robot)):
            run = dataclasses.replace(hands, motion="target", target=target, duration=4.0)
            runs.append(TuningRun(f"target {i + 1}, {name}", ARMS, run))
        reach = dataclasses.replace(hands, motion="beyond-reach", duration=6.0)
        runs.append(TuningRun(f"beyond reach, {name}", ("workspace", "joint_limit"), reach))
        sphere = dataclasses.replace(hands, motion="hold", obstacle=True, duration=5.0)
        runs.append(TuningRun(f"obstacle, {name}", ("obstacle", "self_collision"), sphere))
    return runs + _leg_runs(options)


def _leg_runs(options: TuneOptions) -> list[TuningRun]:
    legs = ("leg_collision", "joint_limit")
    runs = []
    for mass in LEG_MASSES:
        plant = PlantOptions(mass_scale=mass, actuator_delay=min(LEG_DELAY, options.delay))
        steps = LateralSteps(robot=options.robot, plant=plant, duration=9.0)
        runs.append(TuningRun(f"side steps, mass x{mass:g}", legs, steps))
        walk = Walk(robot=options.robot, plant=plant, vx=0.3, wz=0.1, duration=8.0)
        runs.append(TuningRun(f"walk, mass x{mass:g}", legs, walk))
    heavy = PlantOptions(mass_scale=LEG_MASSES[1])
    taichi = Taichi(robot=options.robot, plant=heavy, duration=18.0)
    return [*runs, TuningRun("one leg, heavy", ("joint_limit",), taichi)]
