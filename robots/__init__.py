"""Robots as data: descriptions, the models built from them, and the messages between layers."""
