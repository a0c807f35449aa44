"""What an editor wants to know of a scene while it is written: errors, completions, meanings, places.

``language.reading`` reads a text statement by statement, and again only those that have changed; ``language.judging``
and ``evaluating`` say what is wrong with it. ``completing``, ``meanings`` and ``places`` are functions of what was
read. ``server`` tells all of these to an editor, by the Language Server Protocol; it needs pygls, the others need
nothing.
"""
