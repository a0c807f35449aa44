"""From a scene file to an image file, for the rooms ``cli``, ``live``, ``compare`` and ``parallel``.

``session``: sets up Mitsuba; ``scene_file``: a scene, read once, with ``overrides`` of its parameters;
``confinement``: the files that it names, which must be in its folder; ``errors``: better messages; ``rendering``:
progressive renders; ``black``: why an image is black; ``images``: EXR and PNG files.
"""
