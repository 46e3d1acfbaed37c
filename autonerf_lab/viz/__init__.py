"""Pictures: of evaluations, of runs, the page that shows them all; and a field as points, as a film, in a browser."""

from autonerf_lab.viz.figures.alt_text import register

register()  # in a notebook: importing any of the pictures is enough for them to be read aloud
