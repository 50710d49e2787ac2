"""Judges one episode: outcome, fault and metrics."""
