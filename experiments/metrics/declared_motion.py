"""The metrics that only some scenarios have, declared."""

from experiments.metrics.metric import Metric

STEPS = Metric(
    "steps",
    "steps",
    group="locomotion",
    stored="-",
    meaning="number of steps",
)

WALKING = (
    STEPS,
    Metric(
        "distance_m",
        "way walked",
        "m",
        group="locomotion",
        stored="m",
        meaning="way of the middle between the soles, in straight lines from the start over the ends of all steps",
    ),
    Metric(
        "step_height_min_m",
        "lowest step",
        "mm",
        1e3,
        group="locomotion",
        stored="m",
        meaning="smallest over the finished steps of how high the sole came above where it left the ground; `null` "
        "where there are none",
    ),
    Metric(
        "velocity_error_x_mps",
        "velocity error forward, mean",
        "m/s",
        group="locomotion",
        stored="m/s",
        meaning="mean size of the body's forward velocity less the command, over pairs of steps (a left and a right "
        "one: swaying cancels) in which, and in the step before, the command is the same; `null` where there "
        "are none",
    ),
    Metric(
        "velocity_error_x_max_mps",
        "velocity error forward, largest",
        "m/s",
        group="locomotion",
        stored="m/s",
        meaning="the largest of them; `null` likewise",
    ),
    Metric(
        "velocity_error_y_mps",
        "velocity error sideways, mean",
        "m/s",
        group="locomotion",
        stored="m/s",
        meaning="the same mean to the left; `null` likewise",
    ),
    Metric(
        "velocity_error_y_max_mps",
        "velocity error sideways, largest",
        "m/s",
        group="locomotion",
        stored="m/s",
        meaning="the largest of them; `null` likewise",
    ),
    Metric(
        "velocity_error_wz_radps",
        "error of turning, mean",
        "rad/s",
        group="locomotion",
        stored="rad/s",
        meaning="the same mean of the turning velocity; `null` likewise",
    ),
    Metric(
        "velocity_error_wz_max_radps",
        "error of turning, largest",
        "rad/s",
        group="locomotion",
        stored="rad/s",
        meaning="the largest of them; `null` likewise",
    ),
)
"""Of everything that walks on command."""

FEET = (
    STEPS,
    Metric(
        "min_h_feet_m",
        "smallest barrier between the feet",
        "mm",
        1e3,
        bad="negative",
        group="safety",
        stored="m",
        meaning="smallest true signed distance of the two feet, over all steps of the physics",
    ),
    Metric(
        "min_h_legs_m",
        "smallest barrier between legs",
        "mm",
        1e3,
        bad="negative",
        group="safety",
        stored="m",
        meaning="the same of all pairs of legs, feet included",
    ),
    Metric(
        "feet_penetrate_fraction",
        "feet overlap",
        "%",
        1e2,
        bad="positive",
        group="safety",
        stored="-",
        meaning="fraction of the time with the feet's distance below zero",
    ),
    Metric(
        "legs_penetrate_fraction",
        "legs overlap",
        "%",
        1e2,
        bad="positive",
        group="safety",
        stored="-",
        meaning="the same of any pair of legs",
    ),
)
"""Of side steps."""

ONE_LEG = (
    Metric(
        "foot_up_s",
        "foot up",
        "s",
        group="balance",
        stored="s",
        meaning="time for which the right sole's centre was more than 10 cm higher than at the start",
    ),
    Metric(
        "right_load_end",
        "weight on the right foot at the end",
        "%",
        1e2,
        group="balance",
        stored="-",
        meaning="fraction of the vertical force that the right foot bears at the end",
    ),
)
"""Of standing on one leg."""

DRAWN = (
    Metric("drawn_mass", "", group="drawn", stored="-", meaning="factor on all masses"),
    Metric("drawn_links", "", group="drawn", stored="-", meaning="factor on the whole mass by the bodies' own factors"),
    Metric("drawn_friction", "", group="drawn", stored="-", meaning="friction of soles and ground"),
    Metric("drawn_noise", "", group="drawn", stored="-", meaning="sensor noise, as --noise-scale has it"),
    Metric("drawn_delay_ms", "", "ms", group="drawn", stored="ms", meaning="time from command to torque"),
    Metric("drawn_commands", "", group="drawn", stored="-", meaning="number of commands"),
    Metric("drawn_pushes", "", group="drawn", stored="N s/kg", meaning="impulses of the pushes, per mass of the robot"),
)
"""Of a random walk: what its seed gave."""
