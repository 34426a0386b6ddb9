"""Barriers: rows h, dh/dq and dh/dt of everything that is to be kept."""
