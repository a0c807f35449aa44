"""Helps an editor with scenes: ``symbols`` finds names, completions and meanings in a text, ``evaluation`` evaluates a
CSG tree in a separate process, and ``language_server`` connects both to an editor.
"""
