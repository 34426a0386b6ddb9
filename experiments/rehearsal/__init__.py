"""Rehearsals of a deployment against a twin: tasks, faults, and what came of them."""
