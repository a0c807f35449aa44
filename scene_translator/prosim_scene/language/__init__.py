"""The scene language: text -> model.

``words`` is the table of the language and ``grammar.lark`` its grammar. ``lexer``, ``parser`` and ``builder`` make of a
text a :class:`~prosim_scene.language.document.Document`, a scene with the places of its values. ``checks`` judges it;
``formatter`` lays a text out anew.
"""

from os import PathLike

from ..model import Scene
from . import parentheses
from .builder import Builder
from .document import Document
from .files import SIZE_LIMIT, too_large
from .messages import Source
from .parser import tokens_and_tree


def document_of(text: str, filename: str | PathLike[str] = "<string>") -> Document:
    """The scene that ``text`` describes, with the places of its values; raises and warns as :func:`parse` does."""
    if len(text) > SIZE_LIMIT:
        raise too_large(filename)
    source = Source(text, filename)
    pieces, tree = tokens_and_tree(source)
    parentheses.judge(source, pieces, tree)
    return Builder(source).document(tree)


def parse(text: str, filename: str | PathLike[str] = "<string>") -> Scene:
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    Raises :class:`SceneError` for any wrong input; what is only doubtful is a :class:`SceneWarning`.
    """
    return document_of(text, filename).scene
