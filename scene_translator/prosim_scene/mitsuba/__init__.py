"""The targets of a translation.

``prosim`` uses this project's plugins, ``stock`` only Mitsuba's own. Each is a module with these names:

``SAMPLER``
    The sampler for N^2 samples a pixel.
``settings(context)``
    The entries of the scene's dictionary for its settings: the integrator, and others.
``camera(context, camera)``
    The nearest camera that the target has.
``light(context, number, light)``
    An emitter, or a shape with an emitter.
``surface(context, number, leaf, sides)``
    The entries of a shape for the SURFACE of a leaf, node ``number`` of the CSG tree, with the media ``sides``.

Both use ``lights``, ``materials``, ``textures`` and ``sensor``, and the state of a translation in
``translation_context``; ``assemble`` makes the whole scene.
"""

from . import prosim_target, stock_target

TARGETS = {"prosim": prosim_target, "stock": stock_target}
