"""The closed loop, and what runs it."""
