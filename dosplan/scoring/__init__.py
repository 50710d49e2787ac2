"""Scores one episode: outcome, fault and metrics."""
