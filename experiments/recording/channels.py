"""The recorded arrays of a run, declared; nothing heavy is imported here."""

from dataclasses import dataclass

from robots.checks import require_one_of

CLOCKS = ("tick", "step", "run")
"""How often an array has a row: per control tick, per physics step, once."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One array of ``series.npz``.

    Attributes:
        name: in the file.
        shape: T ticks, P physics steps, nj joints, nq = 7 + nj, nv = 6 + nj, K corners of the support polygon.
        unit: of its entries.
        per: one of ``CLOCKS``.
        meaning: in words.
    """

    name: str
    shape: str
    unit: str
    per: str
    meaning: str

    def __post_init__(self) -> None:
        require_one_of(f"clock of the channel {self.name}", self.per, CLOCKS)


CHANNELS = (
    Channel(
        "time",
        "(T,)",
        "s",
        "tick",
        meaning="beginning of the tick",
    ),
    Channel(
        "q",
        "(T, nq)",
        "m, -, rad",
        "tick",
        meaning="true configuration",
    ),
    Channel(
        "v",
        "(T, nv)",
        "m/s, rad/s",
        "tick",
        meaning="true velocity",
    ),
    Channel(
        "torque",
        "(T, nj)",
        "N m",
        "tick",
        meaning="motor torques of the step before",
    ),
    Channel(
        "com",
        "(T, 3)",
        "m",
        "tick",
        meaning="centre of mass, with the plant's own masses",
    ),
    Channel(
        "com_ref",
        "(T, 3)",
        "m",
        "tick",
        meaning="its reference",
    ),
    Channel(
        "zmp",
        "(T, 2)",
        "m",
        "tick",
        meaning="measured ZMP on the ground, x and y; NaN without contact",
    ),
    Channel(
        "foot_wrench",
        "(T, 2, 6)",
        "N, N m",
        "tick",
        meaning="force, then moment of the ground on each sole, about its centre, in its axes",
    ),
    Channel(
        "soles",
        "(T, 2, 3)",
        "m",
        "tick",
        meaning="centres of the soles",
    ),
    Channel(
        "soles_ref",
        "(T, 2, 3)",
        "m",
        "tick",
        meaning="where they are asked to be",
    ),
    Channel(
        "sole_corners",
        "(T, 2, 4, 2)",
        "m",
        "tick",
        meaning="corners of the soles in the ground plane: front left, rear left, rear right, front right",
    ),
    Channel(
        "in_contact",
        "(T, 2)",
        "",
        "tick",
        meaning="1 where the plan has the foot on the ground, 0 where it has it in the air",
    ),
    Channel(
        "load_scale",
        "(T,)",
        "-",
        "tick",
        meaning="factor on the masses of the controller's model; 1 without `--load-estimate`",
    ),
    Channel(
        "dcm_ref",
        "(T, 2)",
        "m",
        "tick",
        meaning="divergent component of motion that is asked for, x and y; "
        "only in `lateral-steps`, `walk`, `random-walk` and `pushed`",
    ),
    Channel(
        "zmp_ref",
        "(T, 2)",
        "m",
        "tick",
        meaning="ZMP of the same plan; only in `lateral-steps`, `walk`, `random-walk` and `pushed`",
    ),
    Channel(
        "command",
        "(T, 3)",
        "m/s, rad/s",
        "tick",
        meaning="commanded velocity forward, to the left, and turning; only in `walk`, `random-walk` and `pushed`",
    ),
    Channel(
        "left_hand",
        "(T, 3)",
        "m",
        "tick",
        meaning="left hand; only with a hand task, as are the next three",
    ),
    Channel(
        "left_hand_ref",
        "(T, 3)",
        "m",
        "tick",
        meaning="its reference",
    ),
    Channel(
        "right_hand",
        "(T, 3)",
        "m",
        "tick",
        meaning="right hand",
    ),
    Channel(
        "right_hand_ref",
        "(T, 3)",
        "m",
        "tick",
        meaning="its reference",
    ),
    Channel(
        "obstacles",
        "(T, bodies, 3)",
        "m",
        "tick",
        meaning="true reference points of the bodies around the robot (centre of a sphere or box, start of a capsule's "
        "centre line, a point on a half-space's plane); only with `--obstacle`, or a world of the scenario's own",
    ),
    Channel(
        "obstacle",
        "(T, 4)",
        "m",
        "tick",
        meaning="true centre and radius of the first sphere among them; only with `--obstacle`",
    ),
    Channel(
        "v_des",
        "(T, nv)",
        "m/s, rad/s",
        "tick",
        meaning="velocity of KinWBC; NaN where the controller does not run any more",
    ),
    Channel(
        "v_safe",
        "(T, nv)",
        "m/s, rad/s",
        "tick",
        meaning="velocity after the filter; NaN likewise",
    ),
    Channel(
        "filter_status",
        "(T,)",
        "",
        "tick",
        meaning="0 unchanged, 1 filtered, 2 relaxed (least violation), 3 failed (zero velocity), 4 unsafe (the "
        "nominal velocity passed on, only where asked for), 5 stopped (the controller does not run any more)",
    ),
    Channel(
        "filter_slack",
        "(T,)",
        "m/s, rad/s",
        "tick",
        meaning="largest violation of a condition by `v_safe` (with `ecbf` by the acceleration that it asks for, "
        "m/s², rad/s²); 0 for none, infinite where input was not finite, NaN once stopped",
    ),
    Channel(
        "qp_failed",
        "(T,)",
        "",
        "tick",
        meaning="1 where DynWBC had no solution, else 0",
    ),
    Channel(
        "stages",
        "(T, 7)",
        "s",
        "tick",
        meaning="time spent in `kinematics`, `tasks`, `kinwbc`, `rows`, `safety_qp`, `dynamics`, `dynwbc`, in this "
        "order; NaN once stopped",
    ),
    Channel(
        "tick_ms",
        "(T,)",
        "ms",
        "tick",
        meaning="time of the whole tick",
    ),
    Channel(
        "q_estimated",
        "(T, nq)",
        "m, -, rad",
        "tick",
        meaning="configuration that the controller was told, with `--state estimated`",
    ),
    Channel(
        "v_estimated",
        "(T, nv)",
        "m/s, rad/s",
        "tick",
        meaning="velocity that it was told, likewise",
    ),
    Channel(
        "foot_force_estimated",
        "(T, 2)",
        "N",
        "tick",
        meaning="estimated force along the normal of left and right sole, likewise",
    ),
    Channel(
        "contact_estimated",
        "(T, 2)",
        "-",
        "tick",
        meaning="probability that left and right sole stand, likewise",
    ),
    Channel(
        "estimate_ms",
        "(T,)",
        "ms",
        "tick",
        meaning="time of the state estimate, likewise",
    ),
    Channel(
        "h_own",
        "(T, rows)",
        "-",
        "tick",
        meaning="barriers of one's own, each in its unit, as the controller evaluated them; only with such, NaN once "
        "stopped",
    ),
    Channel(
        "step_time",
        "(P,)",
        "s",
        "step",
        meaning="end of the step",
    ),
    Channel(
        "h_self_collision",
        "(P, pairs)",
        "m",
        "step",
        meaning="signed distance of each pair, in single precision",
    ),
    Channel(
        "h_joint_limit",
        "(P,)",
        "rad",
        "step",
        meaning="smallest distance of a joint to one of its limits",
    ),
    Channel(
        "h_workspace",
        "(P, bounds)",
        "m",
        "step",
        meaning="d_max less the distance of the two frames",
    ),
    Channel(
        "h_obstacle",
        "(P,)",
        "m",
        "step",
        meaning="smallest signed distance of a collision body to the obstacle; infinite without one",
    ),
    Channel(
        "h_self_reference",
        "(P,)",
        "m",
        "step",
        meaning="smallest self-collision barrier of the reference motion, the value of each tick repeated over its "
        "steps; only with a hand task",
    ),
    Channel(
        "step_zmp",
        "(P, 2)",
        "m",
        "step",
        meaning="measured ZMP; NaN without contact",
    ),
    Channel(
        "torque_fraction",
        "(P, nj)",
        "-",
        "step",
        meaning="size of each motor torque as a fraction of its limit",
    ),
    Channel(
        "disturbance",
        "(P,)",
        "m/s, rad/s",
        "step",
        meaning="size of the disturbance d, `v` at the step's end less `v_safe` of the tick; NaN once stopped",
    ),
    Channel(
        "gradient",
        "(P, 5)",
        "m/rad, rad/rad",
        "step",
        meaning="longest row of the Jacobian in each family: joint limits, self-collision of arms, torso and head, "
        "self-collision of legs, obstacles, workspace; NaN without rows",
    ),
    Channel(
        "h_bound",
        "(P, 5)",
        "rad, m",
        "step",
        meaning="running bound on the smallest barrier of each of these families; NaN where nothing is guaranteed, "
        "once stopped, and from a change of the filter on",
    ),
    Channel(
        "h_row_bound",
        "(P,)",
        "m",
        "step",
        meaning="bound of the row of the pair of arms, torso and head that is closest; NaN likewise",
    ),
    Channel(
        "support_polygon",
        "(K, 2)",
        "m",
        "run",
        meaning="corners of the convex hull of both soles at the start, anticlockwise, x and y",
    ),
)
"""Of every run, as far as it has them."""
