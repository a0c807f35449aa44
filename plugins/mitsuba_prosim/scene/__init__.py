"""Scene files and image files, for the rooms ``cli``, ``live``, ``compare`` and ``parallel``.

The module ``session`` sets up Mitsuba. ``scene_file`` reads a scene once, and ``overrides`` changes parameters of the
scene. ``confinement`` checks that the files which a scene names are in the scene's folder. ``errors`` improves messages
of Mitsuba. ``rendering`` starts progressive renders. ``black`` finds the reason why an image is black. ``images``
writes EXR and PNG files.
"""
