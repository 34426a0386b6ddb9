"""The arrays of a deployment's recording, declared: what is measured and estimated, since nobody knows what is true."""

from experiments.recording.channels import Channel
from robots.errors import ConfigError

DEPLOYMENT_CHANNELS = tuple(
    Channel(name, shape, unit, "tick", meaning)
    for name, shape, unit, meaning in (
        ("time", "(T,)", "s", "first look at the states of the period, from the first period on"),
        ("stage", "(T,)", "", "number of the stage after the period, in the order of `config.json`"),
        ("go", "(T,)", "", "1 where a person said go at the keyboard; stop and damp likewise"),
        ("stop", "(T,)", "", "see there"),
        ("damp", "(T,)", "", "see there"),
        ("joint_position", "(T, nj)", "rad", "measured; NaN before the first state"),
        ("joint_velocity", "(T, nj)", "rad/s", "measured"),
        ("torque", "(T, nj)", "N m", "measured, as the motors estimate it"),
        ("gyro", "(T, 3)", "rad/s", "measured, in the axes of the IMU of the pelvis"),
        ("accelerometer", "(T, 3)", "m/s^2", "measured, likewise"),
        ("temperature", "(T,)", "degrees Celsius", "of the hottest motor, casing or winding"),
        ("battery", "(T,)", "%", "charge; NaN where nothing was heard of it"),
        ("q_estimated", "(T, nq)", "m, -, rad", "estimated configuration; NaN before the calibration"),
        ("v_estimated", "(T, nv)", "m/s, rad/s", "estimated velocity; NaN likewise"),
        ("foot_force_estimated", "(T, 2)", "N", "estimated force along the normal of left and right sole"),
        ("contact_estimated", "(T, 2)", "-", "probability that left and right sole stand"),
        ("com_estimated", "(T, 3)", "m", "centre of mass at that state; NaN where no controller ran"),
        ("com_ref", "(T, 3)", "m", "its reference; NaN likewise"),
        ("dcm_ref", "(T, 2)", "m", "divergent component of motion that is asked for; only with a gait"),
        ("zmp_ref", "(T, 2)", "m", "ZMP of the same plan; likewise"),
        ("in_contact", "(T, 2)", "", "1 where the plan has the foot on the ground; NaN where no controller ran"),
        ("v_des", "(T, nv)", "m/s, rad/s", "velocity of KinWBC; NaN where no controller ran, or motors fade out"),
        ("v_safe", "(T, nv)", "m/s, rad/s", "velocity after the filter; NaN likewise"),
        ("filter_status", "(T,)", "", "as in a run; 5 where no controller ran"),
        ("filter_slack", "(T,)", "m/s, rad/s", "as in a run; NaN where no controller ran"),
        ("qp_failed", "(T,)", "", "1 where DynWBC had no solution"),
        (
            "h_estimated",
            "(T, 5)",
            "rad, m",
            "smallest barrier of each of `families` at the estimated state, not the true one",
        ),
        ("tick_ms", "(T,)", "ms", "from the first look at the states to the command: estimate and tick"),
        ("age_ms", "(T,)", "ms", "of the last state when the command was ready"),
        ("missing", "(T,)", "", "periods in a row without a new sound state"),
        ("sent", "(T,)", "", "1 where this command was ready in time, 0 where the one before went out again"),
    )
)
"""Of every deployment, as far as its task has them."""


def require_declared(names: set[str]) -> None:
    """Raise :class:`ConfigError` for an array that is not declared."""
    if unknown := names - {channel.name for channel in DEPLOYMENT_CHANNELS}:
        raise ConfigError("arrays", sorted(unknown), "declared in experiments.recording.deployment_channels")
