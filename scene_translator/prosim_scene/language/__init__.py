"""The scene language: reads the text of a scene, and returns a document.

The file ``words.txt`` lists the words of the language, and the module ``words`` reads this list. The module ``tokens``
splits a text into words, numbers and punctuation marks. The module ``reader`` converts the tokens to objects of the
classes in ``model``; the module ``expressions`` computes the values of ``$names`` and of arithmetic. The module
``analysis`` checks the whole scene and returns a :class:`~prosim_scene.language.document.Document`, which has the scene
and the position of each value in the text. The module ``diagnostics`` defines errors and warnings, and the module
``suggestions`` adds hints to error messages. The module ``formatter`` writes a scene in the canonical layout.
"""

from .analysis import document_of, parse

__all__ = ["document_of", "parse"]
