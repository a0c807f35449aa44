"""The thesis's scene language, translated to Mitsuba XML and PLY meshes. Never imports Mitsuba.

    >>> import prosim_scene
    >>> prosim_scene.translate("examples/palito.scn", "build")

Wrong input raises :class:`SceneError`, whose text shows the place; what is only doubtful, or approximated, is a
:class:`SceneWarning`, emitted through :mod:`warnings`. The language is described in ``docs/language.md``.
"""

from .files import read, rewrite
from .kept import Kept
from .language import parse
from .language.diagnostics import SceneError, SceneWarning
from .language.formatter import format
from .model import Scene
from .translator import check, document, load, sensor, translate

__all__ = [
    "Kept",
    "Scene",
    "SceneError",
    "SceneWarning",
    "check",
    "document",
    "format",
    "load",
    "parse",
    "read",
    "rewrite",
    "sensor",
    "translate",
]
