"""Planners without optimisation: the yardsticks that every other planner must beat."""
