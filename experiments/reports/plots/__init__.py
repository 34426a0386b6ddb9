"""Plots of finished runs: one module a subject, one style for all (``style``)."""
