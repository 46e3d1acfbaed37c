"""Figures of evaluations, trajectories and trainings; each function returns a matplotlib Figure.

The public names are listed in ``__init__.pyi`` and load on first use: pictures of scenes and maps need no torch.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
