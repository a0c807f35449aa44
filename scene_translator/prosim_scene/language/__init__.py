"""The scene language: text -> model.

``words`` is the table of the language and ``grammar.lark`` its grammar. ``lexer``, ``parser`` and ``builder`` make of a
text a :class:`~prosim_scene.language.document.Document`, a scene with the places of its values. ``checks`` judges it;
``formatter`` lays a text out anew. ``reading`` reads each statement on its own, and ``judging`` says what is wrong in
all of them.
"""

from collections.abc import Mapping
from os import PathLike

from ..collector import still
from ..model import Scene
from . import parentheses
from .builder import Builder
from .definitions import Definitions
from .document import Document
from .files import SIZE_LIMIT, too_large
from .judging import others
from .messages import SceneError, Source, together
from .parser import tokens_and_tree


def document_of(
    text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None
) -> Document:
    """The scene that ``text`` describes, with the places of its values; raises and warns as :func:`parse` does."""
    if len(text) > SIZE_LIMIT:
        raise too_large(filename)
    source = Source(text, filename)
    definitions = Definitions(source, define)
    try:
        with still():
            pieces, tree = tokens_and_tree(source, definitions)
            definitions.check_uses()
            parentheses.judge(source, pieces, tree)
            return Builder(source, frozenset(definitions.uses)).document(tree)
    except SceneError as error:
        raise together(error, others(error, text, str(filename), define)) from None


def parse(text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None) -> Scene:
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    ``define``: values, numbers or words, of the text's ``$names``; they go before those of DEFAULT statements.
    Raises :class:`SceneError` for any wrong input; what is only doubtful is a :class:`SceneWarning`.
    """
    return document_of(text, filename, define).scene
