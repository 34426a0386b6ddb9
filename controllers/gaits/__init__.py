"""Gaits: walking, side steps, standing on one leg, and the parts that they are made of."""
