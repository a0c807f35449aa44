"""Reads scene files, starts renders and encodes images, for the commands, the live views and the other packages.

The module ``session`` sets up Mitsuba. The module ``scene_file`` parses a scene file once and makes Mitsuba scenes from
the parsed file; the module ``overrides`` changes the film, the integrators and the samplers of a parsed scene. The
module ``confinement`` checks that a scene uses only files in the folder of the scene file. The module ``errors`` adds
details to Mitsuba's error messages. The module ``rendering`` starts progressive renders. The module ``black`` finds the
reason why a rendered image is black. The module ``images`` encodes EXR and PNG files.
"""
