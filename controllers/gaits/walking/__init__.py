"""Walking on command: phases, plans of ZMP and DCM, footholds, and what moves them when the robot is pushed."""

from controllers.gaits.walking.commanded import CommandedWalk
from controllers.gaits.walking.config import WalkTuning, walk_tuning, walking_changes
from controllers.gaits.walking.footsteps import FootstepPlanner, StepLimits, VelocityFootsteps
from controllers.gaits.walking.phases import Support
from controllers.gaits.walking.walking import Walking

__all__ = [
    "CommandedWalk",
    "FootstepPlanner",
    "StepLimits",
    "Support",
    "VelocityFootsteps",
    "WalkTuning",
    "Walking",
    "walk_tuning",
    "walking_changes",
]
