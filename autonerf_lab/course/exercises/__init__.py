"""Exercises of the notebooks, with their solutions and checks."""
