"""Recordings and trajectories, and their files."""
