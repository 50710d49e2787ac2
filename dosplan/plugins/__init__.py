"""Finds planners and predictors, builds them with their options, and checks their contract."""
