"""The scene language: reads the text of a scene, and returns a document.

``words.txt`` lists the words of the language, and ``words`` reads this list. ``tokens`` splits a text into words,
numbers and marks. ``reader`` turns the tokens into values of the classes in ``model``; ``expressions`` computes names
and arithmetic. ``analysis`` checks the whole scene and returns a :class:`~prosim_scene.language.document.Document`: the
scene with the position of each value in the text. ``diagnostics`` defines errors and warnings, ``suggestions`` adds
hints to error messages. ``formatter`` writes a scene in the canonical layout.
"""

from .analysis import document_of, parse

__all__ = ["document_of", "parse"]
