"""laploop: depth-in-the-loop laparoscopic control, simulated end to end."""

from importlib.metadata import version

__version__ = version("laploop")
__all__ = ["__version__"]
