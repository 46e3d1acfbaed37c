"""Pictures: of evaluations, of runs, the page that shows them all; and a field as points, as a film, in a browser."""
