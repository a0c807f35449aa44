"""Reads scene files, starts renders and encodes images, for the commands, the live views and the other packages."""
