"""One tick of the stack, from state and references to the motor command, and its configuration."""
