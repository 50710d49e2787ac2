"""Traffic that SUMO drives around the ego."""
