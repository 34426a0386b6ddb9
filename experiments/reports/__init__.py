"""Plots, pages and films of recordings."""
