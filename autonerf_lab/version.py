"""Version of the package. Here, because every layer may import it."""

__version__ = "0.2.0.dev0"
