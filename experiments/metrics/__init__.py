"""Metrics of recordings."""
