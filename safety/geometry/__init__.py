"""Distances between capsules, boxes and planes, with their gradients."""
