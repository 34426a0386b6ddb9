"""What drives a real robot: stages from the hoist to the task and to damping, protection, guardian, log."""
