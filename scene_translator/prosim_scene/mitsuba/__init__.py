"""Translates scenes for a target, which determines the plugins that the translated scene uses.

The target ``prosim`` uses the plugins of this project, the target ``stock`` uses only plugins that are part of Mitsuba.
Each target is a module that defines:

``SAMPLER``
    The name of the sampler plugin; its sample count is N^2, where N is NSAMPLES of the scene.
``settings(context)``
    Returns the scene's settings, such as the integrator, as entries of the scene's dictionary.
``camera(context, camera)``
    Returns the given camera, or the most similar camera that the target supports.
``light(context, number, light)``
    Returns the dictionary of an emitter, or of a shape with an emitter, for an AREA or POINT light.
``surface(context, number, leaf, sides)``
    Returns the entries of a shape's dictionary for the SURFACE of the primitive ``leaf``, which is node ``number`` of
    the CSG tree. ``sides`` (:class:`.materials.MediumInterface`) are the media on both sides of the surface.

The modules of both targets use the modules ``lights``, ``materials``, ``textures`` and ``sensor``. The class
``Context`` in the module ``translation_context`` has the document and the options of a translation. The module
``assemble`` makes the dictionary of a scene.
"""
