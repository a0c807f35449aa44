"""The scene language: text -> document.

``words`` is the table of the language. ``tokens`` cuts a text into words, numbers and marks, ``reader`` makes of them
the values of the model, with ``expressions`` for arithmetic in braces, and ``analysis`` says what is wrong and makes a
:class:`~prosim_scene.language.document.Document`: a scene with the places of its values. ``diagnostics`` are messages
that show their place, ``suggestions`` what they say of unknown words. ``formatter`` lays a text out.
"""

from .analysis import document_of, parse

__all__ = ["document_of", "parse"]
