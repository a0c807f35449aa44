"""From a scene file to an image file, for the rooms ``cli``, ``live``, ``compare`` and ``parallel``.

``session``: sets up Mitsuba; ``scene_file``: a scene, read once, with ``overrides`` of its parameters; ``references``:
the files that its text names; ``confinement``: to those in its folder; ``errors``: better messages; ``rendering``:
progressive renders; ``report``: their results in words; ``black``: why an image is black; ``images``: EXR and PNG
files.
"""
