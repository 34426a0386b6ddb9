"""A deployment as a recording: what was measured, estimated, asked for and told, period by period, from its log.

A robot does not know its true state, so none is there: barriers are evaluated at the estimated one, and say so.
"""

from typing import Any

import numpy as np

from controllers.agent import Agent, AgentOutput
from controllers.deployment.deployment import Deployment
from controllers.deployment.stages import Stage
from experiments.metrics.balance import versions
from experiments.metrics.deployment import DEPLOYMENT, deployment_figures
from experiments.recording.columns import Columns
from experiments.recording.deployment_channels import require_declared
from experiments.recording.plain import plain
from experiments.recording.recording import GUARANTEED, STOPPED, Recording, description_digest, robot_reference
from experiments.running.deployment_replay import DeploymentLog, Period, ReplayResult
from experiments.running.ground_truth import TrueBarriers
from robots.description import RobotDescription
from robots.errors import SafeWbcError
from robots.messages import Array, RobotState

STAGES = tuple(stage.value for stage in Stage)
"""By the numbers that a recording has for them."""


class DeploymentRecorder:
    """Keeps every period of a replay; hand it over as what is told of them.

    Args:
        robot: the description.
        log: that is replayed.
    """

    def __init__(self, robot: RobotDescription, log: DeploymentLog) -> None:
        self._robot, self._log = robot, log
        self._rows = Columns(log.commands)
        # evaluated at the estimated state here: no other is known
        self._barriers = TrueBarriers(robot, ())
        self._deployment: Deployment | None = None
        self._began = 0.0
        self._nothing = self._nowhere()

    def __call__(self, period: Period) -> None:
        """Take in a period."""
        if self._deployment is None:
            self._deployment, self._began = period.deployment, period.begun
        row = self._nothing | self._measured(period) | self._clock(period)
        if (state := period.deployment.state) is not None:
            row |= self._estimated(state)
        if period.agent is not None and period.output is not None:
            row |= _asked(period.agent, period.output)
        self._rows.append(row)

    def _nowhere(self) -> dict[str, Any]:
        """What is recorded of what is not there."""
        nj = len(self._robot.joints)
        sizes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(("joint_position", "joint_velocity", "torque"), (nj,)),
            **dict.fromkeys(("gyro", "accelerometer", "com_estimated", "com_ref"), (3,)),
            **dict.fromkeys(("foot_force_estimated", "contact_estimated", "in_contact", "dcm_ref", "zmp_ref"), (2,)),
            **dict.fromkeys(("v_estimated", "v_des", "v_safe"), (6 + nj,)),
            **{"q_estimated": (7 + nj,), "h_estimated": (len(GUARANTEED),)},
            **dict.fromkeys(("temperature", "filter_slack", "age_ms"), ()),
        }
        return {name: np.full(size, np.nan) for name, size in sizes.items()} | {
            "filter_status": STOPPED,
            "qp_failed": 0,
        }

    def _measured(self, period: Period) -> dict[str, Any]:
        deployment, around = period.deployment, period.around
        out = {"battery": around.battery, "go": int(around.go), "stop": int(around.stop), "damp": int(around.damp)}
        stream = deployment.stream
        if not np.isfinite(stream.arrived):
            return out
        reading = stream.joints.reading(stream.message, stream.clock.stamp)
        return out | {
            "joint_position": reading.joint_position,
            "joint_velocity": reading.joint_velocity,
            "torque": reading.torque,
            "gyro": reading.gyro,
            "accelerometer": reading.accelerometer,
            "temperature": float(stream.message.motors["temperature"][stream.joints.slots].max()),
            "age_ms": 1e3 * (period.done - stream.clock.stamp),
        }

    def _clock(self, period: Period) -> dict[str, Any]:
        return {
            "time": period.begun - self._began,
            "stage": STAGES.index(period.deployment.stage.value),
            "tick_ms": 1e3 * (period.done - period.begun),
            "missing": period.deployment.missing,
            "sent": int(period.sent),
        }

    def _estimated(self, state: RobotState) -> dict[str, Any]:
        out: dict[str, Any] = {"q_estimated": state.q, "v_estimated": state.v, "h_estimated": self._smallest(state.q)}
        if state.foot_forces is not None:
            out["foot_force_estimated"] = state.foot_forces
        if state.contact is not None:
            out["contact_estimated"] = state.contact
        return out

    def _smallest(self, q: Array) -> Array:
        """Smallest barrier of each family at a configuration; infinite for a family without rows."""
        h, cut = self._barriers.evaluate(q).h, self._barriers.slices
        return np.array([h[cut.get(family, slice(0))].min(initial=np.inf) for family in GUARANTEED])

    def recording(self, result: ReplayResult) -> Recording:
        """Everything recorded, and what it came to.

        Raises:
            SafeWbcError: there was no period.
        """
        if self._deployment is None:
            raise SafeWbcError("the log has no period from its beginning on: there is nothing to record")
        series = {n: a for n, a in self._rows.arrays().items() if n not in ("dcm_ref", "zmp_ref") or not _empty(a)}
        require_declared(set(series))
        return Recording(self._robot, self._config(), self._summary(series, result), series)

    def _config(self) -> dict[str, Any]:
        return robot_reference(self._robot.name) | {
            "robot_digest": description_digest(self._robot),
            "deployment": plain(self._log.head),
            "stages": list(STAGES),
            "families": list(GUARANTEED),
            "metrics": [_table(metric) for metric in DEPLOYMENT],
        }

    def _summary(self, series: dict[str, Array], result: ReplayResult) -> dict[str, Any]:
        deployment = self._deployment
        assert deployment is not None
        figures = deployment_figures(series, STAGES, self._robot.joint_array("effort"))
        if (joint := figures.get("torque_max_joint")) is not None:
            figures["torque_max_joint"] = self._robot.joint_names[joint]
        return figures | {
            "cause": deployment.cause,
            "states_lost": deployment.stream.clock.lost,
            "states_broken": deployment.stream.broken,
            "states_repeated": deployment.stream.repeated,
            "different": result.different,
            "events": [[time - self._began, text] for time, text in result.events],
            "began_monotonic_s": self._began,
            "versions": versions(),
        }


def _asked(agent: Agent, output: AgentOutput) -> dict[str, Any]:
    """What an agent asked for and answered in a tick."""
    reference, result = output.reference, output.result
    out: dict[str, Any] = {
        "com_estimated": agent.controller.kin.com.copy(),
        "com_ref": reference.com.position,
        "in_contact": reference.in_contact.astype(float),
    }
    if reference.dcm is not None:
        out["dcm_ref"], out["zmp_ref"] = reference.dcm.position, reference.dcm.zmp
    if result is not None:
        out |= {
            "v_des": result.v_des,
            "v_safe": result.safety.v,
            "filter_status": int(result.safety.status),
            "filter_slack": result.safety.slack,
            "qp_failed": int(result.dynwbc.status != "optimal"),
        }
    return out


def _empty(values: Array) -> bool:
    return bool(np.isnan(values).all())


def _table(metric: Any) -> dict[str, Any]:
    return {name: getattr(metric, name) for name in ("key", "words", "unit", "factor", "bad", "group")}
