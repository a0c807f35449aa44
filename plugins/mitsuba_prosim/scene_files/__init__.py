"""From a scene file to finished images: what ``prosim compare`` and the commands share.

``session``: Mitsuba made ready; ``opening``: a scene file, read once, with other ``integrators`` if need be, and its
``digest``; ``rendering``: into the film; ``black``: why nothing is seen; ``images``: the film as an EXR and a PNG, by
``tone``; ``writing``: files that are complete or not there.
"""
