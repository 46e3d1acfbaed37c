"""Grids of runs and what they tell together."""
