"""Evaluation of radiance fields: the tasks of the benchmark protocol, one module per task.

The public names are listed in ``__init__.pyi`` and load on first use: tables of finished scores need no torch.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
