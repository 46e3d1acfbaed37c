"""Pictures: of evaluations, of runs, and the page that shows them all."""
