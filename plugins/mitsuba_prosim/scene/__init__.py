"""From a scene file to finished images: what ``prosim compare`` and the commands share.

``session``: Mitsuba made ready; ``scene_file``: a scene, read once, with ``overrides`` of its parameters, and its
``digest``; ``rendering``: into the film; ``black``: why nothing is seen; ``images``: the film as an EXR and a PNG, by
``tone``.
"""
