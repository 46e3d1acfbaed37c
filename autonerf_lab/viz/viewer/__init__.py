"""Interactive viewer of a radiance field in a browser."""
