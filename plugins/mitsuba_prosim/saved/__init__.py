"""Images on their way, as files: to be gone on with, and to be put together from parts."""

from .files import NoStateError, StateError, about, load, save
from .parts import merge

__all__ = ["NoStateError", "StateError", "about", "load", "merge", "save"]
