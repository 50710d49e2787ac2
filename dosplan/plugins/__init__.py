"""Finds plug-ins, builds them with their options, and checks that they keep the contract."""
