"""Samplers of models: placement of sample points on rays."""
