"""The tests of each kind of plugin; a module has the name of its kind."""
