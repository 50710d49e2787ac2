"""Predictors that need no training: kinematic ones, the true future, and circles around either."""
