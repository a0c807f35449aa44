"""Images on their way, as files: to be gone on with, and to be put together from parts."""

from .files import StateError, about, load, save
from .parts import merge

__all__ = ["StateError", "about", "load", "merge", "save"]
