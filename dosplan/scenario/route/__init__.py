"""The ego's route: the lanelets it passes, its reference path and the road beside it."""
