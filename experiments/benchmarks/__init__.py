"""Benchmarks: what is measured, not what is simulated for its own sake."""
