"""The scene language: text -> document.

``words.txt`` is the table of the language; ``words`` reads it. ``tokens`` splits a text into words, numbers and marks.
``reader`` turns them into the values of the model, with ``expressions`` for names and arithmetic. ``analysis`` checks
the whole scene and makes a :class:`~prosim_scene.language.document.Document`: a scene with the spans of its values.
``diagnostics`` has errors and warnings, ``suggestions`` the hints in them. ``formatter`` writes a text in canonical
layout.
"""

from .analysis import document_of, parse

__all__ = ["document_of", "parse"]
