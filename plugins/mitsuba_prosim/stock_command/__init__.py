"""Mitsuba's own ``mitsuba`` command, with plugins written in Python.

That command is a native program without Python. ``prosim link`` puts a library of C, a stand-in, under the name of each
such plugin into Mitsuba's folder of plugins. When the command opens one, the process becomes Python's and renders the
same scenes with the same options.

This room can be deleted, with its line in ``prosim_start/group.py``, when Mitsuba's command runs plugins written in
Python. Mitsuba 3.10 finds them by entry points from Python; whether its command does is to be seen.
"""
