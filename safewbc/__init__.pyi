# The list of the front door. Type checkers and editors read it as it stands, ``__init__.py`` makes its names from it.
from controllers.agent import Agent as Agent
from controllers.gaits.commands import VelocityCommand as VelocityCommand
from controllers.gaits.walking.commanded import CommandedWalk as CommandedWalk
from controllers.gaits.walking.config import walk_tuning as walk_tuning, walking_changes as walking_changes
from controllers.gaits.walking.walking import Walking as Walking
from controllers.motions.hand_targets import HandTargets as HandTargets
from controllers.motions.hands import HandCircles as HandCircles
from controllers.obstacle_tracker import TrackingSettings as TrackingSettings
from controllers.perception import Detection as Detection
from controllers.policies.nominal import NominalPolicy as NominalPolicy
from controllers.reference import WholeBodyReference as WholeBodyReference
from controllers.supervisor import Supervisor as Supervisor
from controllers.whole_body.config import ControllerConfig as ControllerConfig
from controllers.whole_body.controller import WholeBodyController as WholeBodyController
from controllers.whole_body.robot_config import controller_config as controller_config
from controllers.whole_body.task_stack import PlacedTask as PlacedTask
from experiments.recording.recording import (
    Recording as Recording,
    load_recording as load_recording,
    save_recording as save_recording,
)
from experiments.running.loop import ClosedLoop as ClosedLoop, Observer as Observer
from experiments.running.run import run as run
from experiments.scenarios.scenario import Scenario as Scenario, Setup as Setup
from robots.description import RobotDescription as RobotDescription
from robots.errors import ConfigError as ConfigError, SafeWbcError as SafeWbcError
from robots.kinematics import Kinematics as Kinematics
from robots.loader import load_robot as load_robot
from robots.messages import MotorCommand as MotorCommand, RobotState as RobotState
from robots.mujoco_spec import PhysicalChanges as PhysicalChanges
from robots.pinocchio_model import (
    standing_configuration as standing_configuration,
    upper_body_joints as upper_body_joints,
)
from robots.ports import Body as Body
from safety.barriers.barrier import Barrier as Barrier
from safety.barriers.barrier_set import standard_barriers as standard_barriers
from safety.barriers.obstacles import ObstacleBarrier as ObstacleBarrier
from safety.filters.conditions import BarrierParameters as BarrierParameters, FamilyParameters as FamilyParameters
from safety.filters.results import FilterStatus as FilterStatus, explain as explain
from safety.filters.safety_filter import SafetyFilter as SafetyFilter
from safety.geometry.shapes import Obstacle as Obstacle
from safety.tracking import ObstacleTrack as ObstacleTrack, TrackerSettings as TrackerSettings
from sims.kinematic import KinematicPlant as KinematicPlant
from sims.obstacles import PositionSensor as PositionSensor, StraightMotion as StraightMotion
from sims.plant import MujocoPlant as MujocoPlant, PlantConfig as PlantConfig, SensorNoise as SensorNoise
from wbc.tasks.center_of_mass import CenterOfMassTask as CenterOfMassTask
from wbc.tasks.frames import (
    FrameOrientationTask as FrameOrientationTask,
    FramePoseTask as FramePoseTask,
    FramePositionTask as FramePositionTask,
)
from wbc.tasks.posture import PostureTask as PostureTask
from wbc.tasks.task import Task as Task, TaskGains as TaskGains
