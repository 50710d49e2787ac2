"""Planners without optimisation: references that every other planner should beat."""
