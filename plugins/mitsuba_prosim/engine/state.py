"""An image as a state that grows: what is known of every pixel, wave after wave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from .accumulate import Image
from .decisions import Decisions
from .estimate import Estimate, Estimator
from .part import Part, Tiles
from .plan import Plan, Rectangle, area, index_within, pixels, widened

#: Bytes that the sums of all pixels may take. Each has as many as its filter reaches pixels, times the channels: where
#: that is more (images beyond 1920 x 1080 with a wide filter, for example), they are not kept from wave to wave, but
#: taken anew.
KEPT = 1 << 30


class State:
    """The samples of an image so far.

    The first samples of a pixel, as many as it has, are the same whatever was taken when; so the image depends on the
    counts alone. ``margin``: how many pixels beyond its own the image must know, as its decisions look at them;
    ``part``: the part of it whose samples are taken, None for all.
    """

    def __init__(
        self, plan: Plan, estimator: Estimator, own_aovs: Sequence[str], margin: int = 0, part: Part | None = None
    ) -> None:
        self.plan, self.estimator, self.own_aovs, self.part = plan, estimator, own_aovs, part
        #: The pixels that are known, row by row.
        self.outer = widened(plan.region, margin, plan.domain)
        #: How it is cut, if this is a part.
        self.tiles = None if part is None else Tiles.of(plan.region, part.of, margin)
        pixel_count = area(self.outer)
        # Of parts they are always kept, as it is by them that these are put together.
        self.keeps = part is not None or 4 * estimator.values * pixel_count <= KEPT
        self.estimate = Estimate.nothing(estimator.values if self.keeps else 0, pixel_count)
        #: The noise, if it was measured (see :class:`.SecondImage`).
        self.noise = self.noise_99 = self.noise_999 = float("nan")
        self.decisions = Decisions()
        #: What the last whole wave has made, where sums are not kept.
        self.made: Image | None = None

    def share(self, counts: mi.UInt32, reach: int = 0) -> mi.UInt32:
        """``counts`` for the pixels within ``reach`` of this part's, none for the others."""
        if self.part is None or self.tiles is None:
            return counts
        x, y, *_ = pixels(self.outer)
        return dr.select(self.tiles.near(self.part, x, y, reach), counts, 0)

    def places(self, index: mi.UInt32) -> tuple[mi.Int32, mi.Int32]:
        """The pixels with these indices."""
        left, top, right, _ = (dr.opaque(mi.Int32, v) for v in self.outer)
        y = mi.Int32(index) // (right - left)
        return mi.Int32(index) - y * (right - left) + left, y + top

    # ---------------------------------------------------------------- what it shows

    @property
    def current(self) -> bool:
        """Whether :meth:`image` has all samples so far, and not those of the last whole wave alone."""
        rows = self.decisions.rows
        return self.keeps or rows is None or rows[0] is self.made

    def image(self) -> Image:
        """The image so far; pixels without samples are black."""
        if self.made is not None:
            return self.made
        image = self.black()
        if self.keeps:
            for band in self.bands(self.plan.region):
                self.add(image, self.outer, band, self.estimate)
        return image

    @property
    def aov_names(self) -> list[str]:
        """Names of what the film has beside its own channels, as the integrator's ``aov_names()``."""
        names = self.estimator.channels.names
        return [*names[names.index("W") + 1 :], *self.own_aovs]

    def black(self) -> Image:
        """The image of no samples."""
        return Image(self.plan.window, self.estimator.channels.names, len(self.own_aovs))

    def bands(self, rectangle: Rectangle) -> Iterator[Rectangle]:
        """``rectangle`` in parts of at most ``band`` pixels or of one row, from top to bottom."""
        left, top, right, bottom = rectangle
        rows = max(1, self.plan.band // (right - left))
        for begin in range(top, bottom, rows):
            yield left, begin, right, min(begin + rows, bottom)

    def add(self, image: Image, outer: Rectangle, band: Rectangle, estimate: Estimate) -> None:
        """Adds the pixels of ``band`` to ``image``; ``estimate`` is laid out over ``outer``."""
        aovs = [own_channel(name, estimate, self.plan.n) for name in self.own_aovs]
        image.add(outer, band, estimate.sums, estimate.count, aovs, self.plan.reach)

    # ---------------------------------------------------------------- what it knows

    def index(self, x: mi.Int32, y: mi.Int32) -> mi.UInt32:
        """Numbers of the pixels (x, y) in the arrays of ``estimate``."""
        return index_within(self.outer, x, y)

    def counts(self) -> mi.UInt32:
        """Number of samples of each pixel whose samples reach the window, row by row."""
        if self.outer == self.plan.region:
            return self.estimate.count
        x, y, *_ = pixels(self.plan.region)
        return dr.gather(mi.UInt32, self.estimate.count, index_within(self.outer, x, y))

    def judge(
        self, judgement: Callable[[Estimate, mi.UInt32, mi.UInt32], mi.Float], reach: int, margin: int = 0
    ) -> mi.Float:
        """What ``judgement(estimate, width, height)`` says of each pixel whose samples reach the window, and of those
        within ``margin`` of them, from those of a rectangle that holds all within ``reach``; 0 for the other pixels
        that are known.
        """
        result = dr.zeros(mi.Float, area(self.outer))
        for band in self.bands(widened(self.plan.region, margin, self.plan.domain)):
            around = widened(band, reach, self.plan.domain)
            x, y, width, height = pixels(around)
            known = self.estimate.at(index_within(self.outer, x, y)) if around != self.outer else self.estimate
            values = judgement(replace(known, sums=[]), width, height)
            if band == self.outer:
                return values
            x, y, *_ = pixels(band)
            dr.scatter(result, dr.gather(mi.Float, values, index_within(around, x, y)), index_within(self.outer, x, y))
            dr.eval(result)
        return result


def own_channel(name: str, estimate: Estimate, n: int) -> mi.Float:
    """``samples``: of each pixel; ``error``: the standard error of its luminance."""
    return mi.Float(estimate.count) if name == "samples" else estimate.error(n)
