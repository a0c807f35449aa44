"""Mitsuba's own ``mitsuba`` command, with plugins in Python.

That command is a native program without Python. ``prosim link`` writes a C library, a stand-in, under the name of each
such plugin to Mitsuba's folder of plugins. When the command opens one, a Python process takes its place and renders the
same scenes with the same options.

Delete this room, its test ``tests/cli/test_mitsuba_command.py`` and the line of ``link`` in ``prosim_start/group.py``
when Mitsuba's command runs plugins in Python. Mitsuba 3.10 finds them by entry points, but only from Python; its
command (master of August 2026) does not.
"""
