"""The hoist that a robot hangs from: a rope on a gantry, lowered and raised."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robots.checks import require_positive
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant


@dataclass(frozen=True, slots=True)
class HoistConfig:
    """A rope and the person at it.

    Attributes:
        lift: height of the soles over the ground while the robot hangs [m].
        slack: length of rope beyond the distance, at which lowering ends [m].
        lower_speed: [m/s].
        raise_speed: [m/s].
        length: of the rope while the robot hangs [m].
        stretch: of the rope under the robot's weight [m].
        damping_ratio: of the robot on the rope, up and down [-].
        swing: damping of the held point's way to the sides, for each kg of the robot [1/s].
        turn: damping of the torso's rates [N m s/rad].
    """

    lift: float = 0.15
    slack: float = 0.35
    lower_speed: float = 0.05
    raise_speed: float = 0.1
    length: float = 1.0
    stretch: float = 0.03
    damping_ratio: float = 0.5
    swing: float = 4.0
    turn: float = 5.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"hoist {name}", getattr(self, name))


class Hoist:
    """A rope from a gantry to the torso; it pulls and never pushes.

    It is tied to the torso between the shoulders, right above the robot's centre of mass in its posture ``standing``,
    so that the robot hangs upright. While the rope is slack its anchor follows the torso on rails.

    Attributes:
        anchor: shape (3,) upper end of the rope [m].
        length: of the rope, unstretched [m].
        tension: of the last step [N].
        moving: ``lower``, ``raise``, or empty while the rope is held.
    """

    def __init__(self, plant: MujocoPlant, config: HoistConfig | None = None) -> None:
        """Hang ``plant``'s robot up, at rest in its posture ``standing``, the rope stretched by its weight."""
        self._plant, self.config = plant, config or HoistConfig()
        robot = plant.robot
        self._torso = int(plant.data.body(robot.frame(robot.roles["torso"]).body).id)
        q = standing_configuration(robot)
        q[2] += self.config.lift
        plant.reset(q)
        self._weight = plant.total_mass * float(np.linalg.norm(plant.model.opt.gravity))
        self._stiffness = self._weight / self.config.stretch
        self._damping = 2.0 * self.config.damping_ratio * np.sqrt(self._stiffness * plant.total_mass)
        self._tied = self._body_axes().T @ (self._above_the_centre() - plant.data.xpos[self._torso])
        self.length = self.config.length
        self.anchor = self.point() + np.array([0.0, 0.0, self.length + self.config.stretch])
        self.tension, self.moving = self._weight, ""
        self._velocity = np.zeros(6)

    def _above_the_centre(self) -> Array:
        """The point above the centre of mass at the height of the shoulders (3,) [m]."""
        roles, plant = self._plant.robot.roles, self._plant
        height = max(plant.frame_position(roles[side])[2] for side in ("left_shoulder", "right_shoulder"))
        return np.array([*plant.center_of_mass()[:2], height])

    def _body_axes(self) -> Array:
        return np.array(self._plant.data.xmat[self._torso].reshape(3, 3))

    def point(self) -> Array:
        """Where the rope is tied to the torso, in the world (3,) [m]."""
        return np.array(self._plant.data.xpos[self._torso] + self._body_axes() @ self._tied)

    @property
    def slack(self) -> float:
        """Length of rope beyond the distance from anchor to torso, below 0 where it is taut [m]."""
        return self.length - float(np.linalg.norm(self.anchor - self.point()))

    def lower(self) -> None:
        """Let rope out until it is slack."""
        self.moving = "lower"

    def lift(self) -> None:
        """Take rope in until the soles are clear of the ground."""
        self.moving = "raise"

    def step(self, dt: float) -> Array:
        """Move the rope by ``dt`` [s]; returns its wrench on the torso (6,), about the body's CoM [N, N m]."""
        rate = self._move(dt)
        point = self.point()
        rope = self.anchor - point
        distance = float(np.linalg.norm(rope))
        stretch = distance - self.length
        if stretch <= 0.0:
            self.tension = 0.0
            self.anchor[:2] = point[:2]
            return np.zeros(6)
        data = self._plant.data
        mujoco.mj_objectVelocity(self._plant.model, data, mujoco.mjtObj.mjOBJ_BODY, self._torso, self._velocity, 0)
        arm = point - data.xipos[self._torso]
        turning = self._velocity[:3]
        velocity = self._velocity[3:] + _cross(turning, arm)
        along = rope / distance
        closing = -float(along @ velocity) - rate
        self.tension = max(0.0, self._stiffness * stretch + self._damping * closing)
        aside = velocity - (velocity @ along) * along
        force = self.tension * along - self.config.swing * self._plant.total_mass * aside
        return np.concatenate([force, _cross(arm, force) - self.config.turn * turning])

    def _move(self, dt: float) -> float:
        """Let out or take in; returns the rate of the rope's length [m/s]."""
        if self.moving == "lower" and self.slack >= self.config.slack:
            self.moving = ""
        elif self.moving == "raise" and self._plant.sole_corners()[..., 2].min() >= self.config.lift - 1e-4:
            self.moving = ""
        if not self.moving:
            return 0.0
        rate = self.config.lower_speed if self.moving == "lower" else -self.config.raise_speed
        if self.length + rate * dt < self.config.length / 2.0:
            self.moving = ""
            return 0.0
        self.length += rate * dt
        return rate


def _cross(a: Array, b: Array) -> Array:
    """Their cross product (3,): numpy's takes 50 us, in every millisecond."""
    product = np.empty(3)
    mujoco.mju_cross(product, a, b)
    return product


def holding_torque(plant: MujocoPlant, wrench: Array) -> Array:
    """Motor torques (nj,) that keep a robot at rest under ``wrench`` (6,) on its torso, as of a rope [N m]."""
    model, data = plant.model, plant.data
    torso = int(data.body(plant.robot.frame(plant.robot.roles["torso"]).body).id)
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    pulled = np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[torso], torso, pulled)
    torque = np.array(data.qfrc_inverse - pulled)[6:]
    mujoco.mj_forward(model, data)
    return np.clip(torque, -plant.effort, plant.effort)
