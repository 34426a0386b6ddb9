"""Nominal policies of the kinematic benchmarks."""
