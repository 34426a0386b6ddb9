"""Safety: barriers, conditions on the velocity, filters, obstacle tracks."""
