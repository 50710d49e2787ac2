"""Draws episodes: pictures, GIFs and videos."""
