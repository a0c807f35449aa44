"""The ``prosim`` command line, and the Python side of the ``mitsuba`` command."""
