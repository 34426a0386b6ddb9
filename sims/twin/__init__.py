"""The twin of a G1: a process that plays the robot over DDS in real time, with its faults and its hoist."""
