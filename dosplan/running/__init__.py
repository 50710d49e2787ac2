"""Runs of many episodes: the configuration, the executors, and the loop that writes the rows."""
