"""Interactive figures of the notebooks."""
