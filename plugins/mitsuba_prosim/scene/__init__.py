"""Scene files and image files, for the folders ``cli``, ``live``, ``compare`` and ``parallel``.

The module ``session`` sets up Mitsuba. ``scene_file`` parses a scene file once and makes scenes from the result;
``overrides`` changes the film and the integrators of the parsed scene. ``confinement`` checks that the files which a
scene names are in the scene's folder. ``errors`` improves messages of Mitsuba. ``rendering`` starts progressive
renders. ``black`` finds the reason why an image is black. ``images`` writes EXR and PNG files.
"""
