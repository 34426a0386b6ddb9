"""Balance: the plan of the divergent component of motion, and the feedback that keeps to it."""
