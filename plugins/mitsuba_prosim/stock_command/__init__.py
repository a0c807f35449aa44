"""Lets Mitsuba's own command ``mitsuba`` run plugins that are written in Python.

The command ``mitsuba`` that pip installs is a script that starts a native program, which has no Python. ``prosim link``
lets the script first ask the module ``launcher`` here, which renders scenes with plugins in Python itself, with the
same options.

Delete this folder, its test ``tests/cli/test_mitsuba_command.py`` and the line of ``link`` in ``prosim_start/group.py``
when the command ``mitsuba`` runs plugins in Python. Mitsuba 3.10 finds plugins that are written in Python by the entry
points of installed packages, but only if Mitsuba is used from Python, not if its command runs (true of Mitsuba's branch
master in August 2026).
"""
