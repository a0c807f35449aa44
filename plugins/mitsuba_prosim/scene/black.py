"""Finds the reason why an image is black."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np

#: Half of the darkest grey of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92

#: How to make an image brighter; ``{}``: the exposure in stops.
IN_THE_PNG = "The EXR has it all; --exposure {} makes it bright in the PNG"


def reason(scene: mi.Scene, colours: np.ndarray, brighter: str = IN_THE_PNG, exposure: float = 0.0) -> str | None:
    """The reason why an image is black, or what to look for; None for any other image.

    ``colours``: linear, as they are displayed with ``exposure``; ``brighter``: as :data:`IN_THE_PNG`.
    """
    brightest = float(np.fmax.reduce(colours, axis=None, initial=0.0))  # ignores NaN
    if brightest >= BLACK:
        return None
    if brightest > 0:
        enough = brighter.format(f"{exposure + math.ceil(-math.log2(brightest)):g}")
        text = f"its brightest value is {brightest:.2g}, white being 1. {enough}, and so do brighter lights."
    elif not scene.emitters():
        text = "the scene has no lights."
    else:
        text = (
            "nothing is in view, no light arrives there, or none is reflected to the eye. Does the camera look at the "
            "scene, from outside of its solids? Are the lights dark, enclosed, or turned away?"
        )
    return "the picture is black: " + text
