"""The files that recordings and trajectories are kept in."""
