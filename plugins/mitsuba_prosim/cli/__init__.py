"""The ``prosim`` command line."""
