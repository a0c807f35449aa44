"""Translates scenes for a target, which determines the plugins that the translated scene uses.

The target ``prosim`` uses the plugins of this project, the target ``stock`` uses only plugins that are part of Mitsuba.
Each target is a module that has the attributes of the protocol ``Target`` in the module ``assemble``, which makes the
dictionary of a scene.

The modules of both targets use the modules ``lights``, ``materials``, ``textures`` and ``sensor``. The class
``Context`` in the module ``translation_context`` has the document and the options of a translation.
"""
