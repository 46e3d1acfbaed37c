"""Exercises of the notebooks with test cases, solutions and hints; one module per notebook."""
