"""Motions of the hands and the centre of mass."""
