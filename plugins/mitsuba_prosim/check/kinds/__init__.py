"""The tests of each kind of plugins: a subclass of ``Tests`` with the name of Mitsuba's class."""
