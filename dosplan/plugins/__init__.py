"""Finds plug-ins, builds them with their options, and checks their contract."""
