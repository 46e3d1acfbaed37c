"""Interactive widgets of the notebooks."""
