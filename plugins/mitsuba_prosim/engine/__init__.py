"""From samples to an image (thesis, section 5.3.2).

``integrator`` is what plugins are made of. ``waves``: the loop over an image, ``growth``, that grows; ``policies``:
which pixels get how many samples, ``decisions``: what of that was decided; ``target``, ``twin`` and ``pursuit``: until
it is good enough. ``plan``: which samples there are; ``state``: what is known of every pixel, by an ``estimate`` of
each; ``cutting``: what it lacks in portions, and ``taking``: who takes them; ``accumulate`` and ``film``: what becomes
of them. ``snapshot``: what can be seen meanwhile, ``record``: what another process has to know, and ``part``: what it
may render.
"""
