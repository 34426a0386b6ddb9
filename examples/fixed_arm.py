"""The filter alone: the G1's upper body on a stand, velocities in and out, no dynamics and no torques.

python examples/fixed_arm.py
"""

import numpy as np

import safewbc as sw

DT = 0.01
"""Period of the filter [s]."""


def main(duration: float = 4.0) -> tuple[float, float]:
    """Reach through a box; returns the box's smallest barrier and the hand's last distance from its goal [mm]."""
    robot = sw.load_robot("g1")
    kin = sw.Kinematics(robot, base="fixed", joints=sw.upper_body_joints(robot))
    plant = sw.KinematicPlant(kin, kin.posture("hands_front"))
    kin.update_geometry(plant.q)
    hand = kin.frame_id(robot.roles["left_hand"])
    start = kin.frame_placement(hand)[1].copy()

    limits = np.full(kin.nv, 1.5)
    policy = sw.NominalPolicy(kin, [(robot.roles["left_hand"], np.zeros(3))], kin.posture("hands_front"), limits=limits)
    policy.points[0].position = start + np.array([0.0, 0.25, 0.0])
    box = sw.Obstacle.box(start + np.array([0.03, 0.13, -0.08]), np.eye(3), np.array([0.06, 0.03, 0.06]))
    barriers = sw.standard_barriers(kin, obstacle_kinds=("box",))
    next(b for b in barriers.barriers if isinstance(b, sw.ObstacleBarrier)).set_obstacles([box])
    safety = sw.SafetyFilter("cbf", barriers.size, sw.BarrierParameters(), limits)

    smallest = np.inf
    for _ in range(round(duration / DT)):
        kin.update_geometry(plant.q)
        rows = barriers.evaluate(kin)
        smallest = min(smallest, rows.h[barriers.slices["obstacle"]].min())
        result = safety.apply(rows, policy.velocity(kin))
        plant.step(result.v, DT)
    kin.update_geometry(plant.q)
    left = np.linalg.norm(kin.frame_placement(hand)[1] - policy.points[0].position)
    print(f"smallest barrier of the box {1e3 * smallest:.1f} mm, hand {1e3 * left:.0f} mm from its goal")
    print("last answer:", sw.explain(result, barriers.labels))
    return 1e3 * smallest, 1e3 * float(left)


if __name__ == "__main__":
    main()
