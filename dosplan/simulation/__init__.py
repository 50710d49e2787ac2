"""Drives one episode in closed loop."""
