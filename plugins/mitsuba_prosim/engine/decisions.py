"""What has been decided of an image on its way, beside its samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mitsuba as mi

if TYPE_CHECKING:
    from .accumulate import Image
    from .estimate import Estimate


@dataclass
class Decisions:
    """All that the next step of an image follows from, with the samples that it has: who knows both goes on as if there
    had been nothing between. Dr.Jit arrays have one entry a pixel that is known.
    """

    #: How often it has been judged what the pixels need; 0 before the end of the first wave.
    judged: int = 0
    #: The counts that the wave at hand leads to; None in the first one and between two.
    wanted: mi.UInt32 | None = None
    #: Where noise or time were asked for: how many samples there are for each that is needed; and, if that is judged
    #: once, what is needed.
    effort: float = 0.0
    need: mi.Float | None = None
    #: Samples of the :class:`.SecondImage`, of its pixels alone.
    twin: Estimate | None = None
    #: Where sums are not kept: the image that the wave at hand has made of the rows above the one of this number.
    rows: tuple[Image, int] | None = None
