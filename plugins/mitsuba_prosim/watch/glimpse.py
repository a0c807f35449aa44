"""What is seen at once where a VIEW has changed: the solids as they are for the last one, until they are made anew."""

from __future__ import annotations

import numpy as np
from prosim_scene import Document

from ..compat import world_matrix
from . import takes
from .camera import Camera
from .subject import Subject


def glimpse(subject: Subject, document: Document, moved: Camera | None) -> tuple[takes.Take, tuple[int, int]] | None:
    """The image, of few pixels, of ``subject`` by the VIEW of ``document``, and the size that it is to come to.

    None where more than that VIEW is another than in ``subject``, and where the camera is ``moved`` and stays where it
    is, as the eye does. Raises :class:`prosim_scene.SceneError` for a view that there can't be.
    """
    turned = subject.turned(document)
    if turned is None:
        return None
    sensor, size = turned
    to_world = world_matrix(sensor)
    if moved is not None and subject.home is not None and np.allclose(to_world, subject.home.to_world):
        return None
    integrator, spp = takes.in_waves(subject.scene.integrator(), sensor, 1)
    return takes.Take(integrator, subject.scene, sensor, spp, 0), size
