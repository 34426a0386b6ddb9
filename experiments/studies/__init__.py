"""Studies: sets of runs, and their tables."""
