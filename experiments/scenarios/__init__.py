"""Scenarios: what happens in a run."""
