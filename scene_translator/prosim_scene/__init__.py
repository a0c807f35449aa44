"""Translates scenes from the thesis's scene language to Mitsuba XML files and PLY meshes. This package never imports
Mitsuba.

    >>> import prosim_scene
    >>> prosim_scene.translate("examples/palito.scn", "build")

If the input is wrong, the functions raise a :class:`SceneError`, whose message shows the wrong part of the scene's
text. A :class:`SceneWarning`, which is emitted through :mod:`warnings`, reports a probable mistake or an approximation.
The page ``docs/language.md`` describes the scene language.
"""

from .language import document_of, parse
from .language.diagnostics import SceneError, SceneWarning, Source, Span
from .language.document import Document
from .language.expressions import FPS, FRAME, TIME
from .language.formatter import format
from .mitsuba.translation_context import images, located, meshes
from .model import Leaf, Scene, View
from .text_files import read, refuse_special, replace, rewrite
from .translator import check, document, load, translate
from .view import distortion_message
from .writer import TranslationCache

__all__ = [
    "FPS",
    "FRAME",
    "TIME",
    "Document",
    "Leaf",
    "Scene",
    "SceneError",
    "SceneWarning",
    "Source",
    "Span",
    "TranslationCache",
    "View",
    "check",
    "distortion_message",
    "document",
    "document_of",
    "format",
    "images",
    "load",
    "located",
    "meshes",
    "parse",
    "read",
    "refuse_special",
    "replace",
    "rewrite",
    "translate",
]
