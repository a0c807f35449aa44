"""The scene language: text -> model.

``words`` is the table of the language and ``grammar.lark`` its grammar. ``lexer``, ``parser`` and ``builder`` make of a
statement what it says; ``units`` reads each on its own, ``shapes`` and ``trees`` those that large scenes are made of at
once, and ``reading`` all of a text. ``judging`` says what is wrong in it, and makes the rest a
:class:`~prosim_scene.language.document.Document`, a scene with the places of its values; ``checks`` knows what has to
be. ``formatter`` lays a text out anew.
"""

import warnings
from collections.abc import Mapping
from os import PathLike

from ..collector import still
from ..model import Scene
from .document import Document
from .files import SIZE_LIMIT, too_large
from .judging import errors, judge
from .messages import Place, together
from .reading import Last


def document_of(
    text: str,
    filename: str | PathLike[str] = "<string>",
    define: Mapping[str, object] | None = None,
    last: Last | None = None,
) -> Document:
    """The scene that ``text`` describes, with the places of its values; raises and warns as :func:`parse` does. What is
    the same as in the ``last`` text is not read again.
    """
    if len(text) > SIZE_LIMIT:
        raise too_large(filename)
    with still():
        reading = (last or Last()).changed(text, str(filename), dict(define or {}))
        found, document = judge(reading)
        wrong = errors(reading, found)
    for one in found:
        if not one.error:
            place = Place(one.start, one.end)
            warnings.warn(reading.source.warning(place, one.reason, names=False), stacklevel=2)
    if document is None:
        raise together(wrong[0], wrong[1:])
    reading.definitions.check_uses()
    return document


def parse(text: str, filename: str | PathLike[str] = "<string>", define: Mapping[str, object] | None = None) -> Scene:
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    ``define``: values, numbers or words, of the text's ``$names``; they go before those of DEFAULT statements.
    Raises :class:`SceneError` for any wrong input; what is only doubtful is a :class:`SceneWarning`.
    """
    return document_of(text, filename, define).scene
