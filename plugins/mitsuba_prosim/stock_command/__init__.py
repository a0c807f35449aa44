"""Lets Mitsuba's own command ``mitsuba`` run plugins that are written in Python.

The command ``mitsuba`` is a native program without Python. For each plugin in Python, ``prosim link`` writes a
stand-in, a small C library with the plugin's name, to Mitsuba's folder of plugins. When the command ``mitsuba`` opens a
stand-in, the stand-in replaces the running process by a Python process, which renders the same scenes with the same
options.

Delete this folder, its test ``tests/cli/test_mitsuba_command.py`` and the line of ``link`` in ``prosim_start/group.py``
when the command ``mitsuba`` runs plugins in Python. Mitsuba 3.10 finds plugins that are written in Python by the entry
points of installed packages, but only if Mitsuba is used from Python, not if its command runs (true of Mitsuba's branch
master in August 2026).
"""
