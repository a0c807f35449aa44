"""Single precision, which is Mitsuba's: what it cannot hold is an error."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..language.document import Document
from ..nodes import Default, Node
from ..solids.transforms import matrices

#: The largest number whose square single precision still holds.
LARGEST = 1e19


def check(document: Document, node: Node, *path: str | int) -> Node:
    """The node itself, if Mitsuba can hold its numbers; a SceneError about what stands at ``path`` if not."""
    for value in _numbers(node):
        if not abs(value) <= LARGEST:
            raise document.error(
                f"this comes to {value:g}, which is beyond single precision, Mitsuba's; expected less extreme numbers",
                *path,
            )
    return node


def check_transforms(document: Document) -> None:
    """Raises the SceneError about a transform that leads beyond single precision."""
    transforms = document.scene.transforms
    if not transforms:
        return
    with np.errstate(all="ignore"):
        found = matrices(list(transforms.values()))
    wrong = ~(np.abs(found).max(axis=(1, 2)) <= LARGEST)
    narrowest = np.linalg.svd(np.where(wrong[:, None, None], 0, found)[:, :3, :3], compute_uv=False).min(axis=1)
    for index, beyond in zip(transforms, (wrong | (narrowest < 1 / LARGEST)).tolist()):
        if beyond:
            raise document.error(
                "these steps together lead beyond single precision, Mitsuba's; expected less extreme factors "
                "and distances",
                "transforms",
                index,
            )


def _numbers(value: Any) -> Iterable[float]:
    if isinstance(value, dict):
        for part in value.values():
            yield from _numbers(part)
    elif isinstance(value, Default):
        yield value.value
    elif isinstance(value, np.ndarray | list | tuple):
        yield from np.ravel(value).tolist()
    elif isinstance(value, int | float):
        yield value
