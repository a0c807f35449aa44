"""Translates scenes from the thesis's scene language to Mitsuba XML files and PLY meshes. This package never imports
Mitsuba.

    >>> import prosim_scene
    >>> prosim_scene.translate("examples/palito.scn", "build")

If the input is wrong, the functions raise a :class:`SceneError`, whose message shows the wrong part of the scene's
text. A :class:`SceneWarning`, which is emitted through :mod:`warnings`, reports a probable mistake or an approximation.
The page ``docs/language.md`` describes the scene language.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .atomic_files import TemporaryFolder, create_folder, guard, refuse_special, replace
    from .geometry import TranslationCache
    from .language.analysis import document_of, parse
    from .language.diagnostics import SceneError, SceneWarning, Source, Span
    from .language.document import Document
    from .language.expressions import FPS, FRAME, TIME
    from .language.formatter import format
    from .mitsuba.translation_context import images, located, meshes
    from .model import Leaf, Scene, View
    from .text_files import read, rewrite
    from .translator import check, document, load, translate
    from .view import distortion_message

__all__ = ["Leaf", "Scene", "View", "check", "document", "document_of", "load", "parse", "translate"]
__all__ += ["FPS", "FRAME", "TIME", "Document", "SceneError", "SceneWarning", "Source", "Span", "TranslationCache"]
__all__ += ["distortion_message", "format", "images", "located", "meshes", "read", "rewrite"]
__all__ += ["TemporaryFolder", "create_folder", "guard", "refuse_special", "replace"]

#: The modules that define the public names. They are imported in this order until a name is found, because the import
#: of all modules takes longer than a small image, and rendering an XML scene needs only the replacement of files.
MODULES = (
    *("atomic_files", "model", "language.diagnostics", "language.document", "language.expressions"),
    *("language.analysis", "language.formatter", "text_files", "view", "geometry"),
    *("mitsuba.translation_context", "translator"),
)


def __getattr__(name: str) -> Any:
    for module in MODULES if name in __all__ else ():
        if hasattr(found := import_module(f"{__name__}.{module}"), name):
            return getattr(found, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
