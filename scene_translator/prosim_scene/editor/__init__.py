"""What an editor wants to know of a scene while it is written: errors, completions, meanings, places.

``buffers`` has a text in an editor's lines and columns. ``language.reading`` reads it statement by statement, and again
only those that have changed; ``language.judging`` and ``evaluating`` say what is wrong with it, the latter in a process
``apart``. ``completing``, ``meanings`` and ``places`` are functions of what was read. ``server`` tells all of these to
an editor, by the Language Server Protocol, of each document that is ``opened``; these two need pygls, the others
nothing.
"""
