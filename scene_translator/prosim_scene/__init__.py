"""The thesis's scene language, translated to Mitsuba XML and PLY meshes. Never imports Mitsuba.

    >>> import prosim_scene
    >>> prosim_scene.translate("examples/palito.scn", "build")

Wrong input raises :class:`SceneError`, whose message shows the place; doubtful or approximated input is a
:class:`SceneWarning`, emitted through :mod:`warnings`. The language is described in ``docs/language.md``.
"""

from .camera import misfit
from .files import PART, read, refuse_special, rewrite
from .language import document_of, parse
from .language.diagnostics import SceneError, SceneWarning, Source, Span
from .language.document import Document
from .language.expressions import FPS, FRAME, TIME
from .language.formatter import format
from .mitsuba.context import images, located, meshes
from .model import Leaf, Scene, View
from .output import Kept
from .translator import check, document, load, sensor, translate

__all__ = [
    "FPS",
    "FRAME",
    "PART",
    "TIME",
    "Document",
    "Kept",
    "Leaf",
    "Scene",
    "SceneError",
    "SceneWarning",
    "Source",
    "Span",
    "View",
    "check",
    "document",
    "document_of",
    "format",
    "images",
    "load",
    "located",
    "meshes",
    "misfit",
    "parse",
    "read",
    "refuse_special",
    "rewrite",
    "sensor",
    "translate",
]
