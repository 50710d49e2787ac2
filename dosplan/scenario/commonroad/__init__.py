"""Reads and writes CommonRoad XML."""
