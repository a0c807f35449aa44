"""From samples to an image (thesis, section 5.3.2).

``integrator``: the base class of plugins. ``render``: the loop over work items that makes an image, and what can be
seen of it meanwhile. ``plan``: which samples there are; ``policies``: how many of them each pixel gets;
``error_target``:
until the image is good enough. ``state``: what is known of every pixel, by an ``estimate`` of each; ``work``: the
samples that are missing, as work items, and the executor that takes them; ``accumulate`` and ``film``: what becomes of
them. ``record``: what another process has to know; ``part``: what it may render; ``derivatives``.
"""
