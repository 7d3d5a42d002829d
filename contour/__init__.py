"""contour: maps the shape of objects by touch with a flexible beam that feels where along itself it touches.

Importing the package loads nothing heavy; see README.md for the modules.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"
