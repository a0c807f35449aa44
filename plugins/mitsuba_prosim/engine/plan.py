"""Which samples an image takes: its pixels, passes and keys (section 5.3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import drjit as dr
import mitsuba as mi

from ..sampling.nrook import NRook, Permutations, grid_size, pixel_key

#: left, top, right, bottom, in pixels of the whole film.
Rectangle = tuple[int, int, int, int]


#: Part of a pattern's samples from which the pattern is worth while.
WORTH_WHILE = 0.2

#: First epoch of a plan that follows another.
LATER = 1 << 16

#: Most samples of a pixel where noise or time say when it is enough; and in N² where ``graded`` does.
UNLIMITED, GRADED = 1 << 20, 4


@dataclass(frozen=True)
class Sampling:
    """How an image is to be sampled, as the integrator's parameters say it; :ref:`integrator-prosim` has their
    meaning.
    """

    samples: int
    adaptive: str
    threshold: float
    min_passes: int
    max_samples: int
    noise: float
    noise_99: float
    time: float
    jitter: str
    band: int

    @property
    def aims(self) -> bool:
        """Whether noise or time end the image."""
        return self.noise > 0 or self.noise_99 > 0 or self.time > 0


#: Names of these parameters.
SAMPLING = tuple(field.name for field in fields(Sampling))


@dataclass(frozen=True)
class Plan:
    """The samples of one image."""

    #: N: samples of a pass.
    n: int
    #: Samples that every pixel gets, those of a noisy pixel, and those that one may get at most: passes, of which the
    #: very last may be cut short.
    least: int
    full: int
    most: int
    #: Places of samples in their cells, ``"multi"`` or ``"uniform"``.
    jitter: str
    permutations: Permutations
    seed: mi.UInt32
    #: The film's crop window.
    window: Rectangle
    #: The pixels that have samples: the film, and what its filter reaches beyond it where the film samples its border.
    domain: Rectangle
    #: Pixels around its own that a sample is spread over.
    reach: int
    #: Pixels that are rendered at a time.
    band: int
    #: What was asked for.
    sampling: Sampling
    #: The plan of the first samples of every pixel, where this one is for those that follow; and how many these are.
    before: Plan | None = None
    begin: int = 0
    skipped: mi.UInt32 | None = None  # the same for kernels
    #: Seed of the photons, where that of the samples may differ from pixel to pixel.
    own_photon_seed: int | None = None

    @classmethod
    def of(cls, sampling: Sampling, film: mi.Film, seed: int | mi.UInt32, spp: int) -> Plan:
        """The plan for ``film``; a nonzero ``spp`` stands for N², in the place of ``samples`` and ``max_samples``."""
        full = spp or sampling.samples**2
        n = grid_size(spp) if spp else min(sampling.samples, sampling.max_samples or full)
        if sampling.aims:
            most = sampling.max_samples or UNLIMITED
        elif sampling.adaptive == "graded":
            most = (0 if spp else sampling.max_samples) or GRADED * full
        else:
            most = full = (0 if spp else sampling.max_samples) or full
        (x, y), (w, h), (width, height) = film.crop_offset(), film.crop_size(), film.size()
        x, y, w, h, width, height = (int(v) for v in (x, y, w, h, width, height))
        reach = film.rfilter().border_size()
        border = reach if film.sample_border() else 0
        seed = mi.UInt32(seed)
        dr.make_opaque(seed)  # Mitsuba's integrators pass on constants
        return cls(
            n,
            min(sampling.min_passes * n, most),
            min(full, most),
            most,
            sampling.jitter,
            Permutations(n),
            seed,
            (x, y, x + w, y + h),
            (-border, -border, width + border, height + border),
            reach,
            sampling.band,
            sampling,
        )

    @property
    def first(self) -> Plan:
        """The plan of the first samples of every pixel."""
        return self.before or self

    @property
    def region(self) -> Rectangle:
        """The pixels whose samples reach the window."""
        return widened(self.window, self.reach, self.domain)

    @property
    def photon_seed(self) -> int:
        """Seed of the photons, for all pixels."""
        return int(self.seed[0]) if self.own_photon_seed is None else self.own_photon_seed

    def points(self, x: mi.Int32, y: mi.Int32, t: mi.UInt32) -> NRook:
        """The ``t``-th sample of the pixels (x, y), in every space: a pure function of seed, pixel and ``t``."""
        # 16 bits for each coordinate, so that a pixel's samples do not depend on the film's size.
        pixel = (mi.UInt32(y) << 16) | (mi.UInt32(x) & 0xFFFF)
        key = pixel_key(self.seed, pixel)
        if self.before is None and self.most <= self.n**2:
            points = NRook.in_first_epoch(self.permutations, key, t, self.jitter)
        elif self.before is None:
            points = NRook.at(self.permutations, key, t, self.jitter)
        else:
            points = NRook.at(self.permutations, key, t - self.skipped, self.jitter, LATER)
        points.t = t
        return points

    def continued(self, n: int, begin: int) -> Plan:
        """The plan by which all samples after the first ``begin`` are patterns of ``n``²."""
        skipped = dr.opaque(mi.UInt32, begin)
        return replace(self, n=n, permutations=Permutations(n, True), before=self, begin=begin, skipped=skipped)

    def stages(self) -> Iterator[tuple[Plan, int]]:
        """The plans of a pixel's samples in their order: ``(plan, number of the sample that is no more its own)``."""
        if self.before is not None:
            yield self.before, self.begin
        yield self, 0xFFFFFFFF

    @property
    def pass_size(self) -> int:
        """Samples of a pass; 0 where there are passes of two sizes."""
        return self.n if self.before is None else 0


def widened(rectangle: Rectangle, reach: int, domain: Rectangle) -> Rectangle:
    """``rectangle`` and the pixels within ``reach`` of it, as far as they are in ``domain``."""
    return (
        max(rectangle[0] - reach, domain[0]),
        max(rectangle[1] - reach, domain[1]),
        min(rectangle[2] + reach, domain[2]),
        min(rectangle[3] + reach, domain[3]),
    )


def pixels(rectangle: Rectangle) -> tuple[mi.Int32, mi.Int32, mi.UInt32, mi.UInt32]:
    """``(x, y, width, height)``: the pixels of a rectangle (left, top, right, bottom), row by row, and its size."""
    left, top, right, bottom = rectangle
    width, height = dr.opaque(mi.UInt32, right - left), dr.opaque(mi.UInt32, bottom - top)
    i = dr.arange(mi.UInt32, (right - left) * (bottom - top))
    y = i // width
    x = i - y * width
    return mi.Int32(x) + dr.opaque(mi.Int32, left), mi.Int32(y) + dr.opaque(mi.Int32, top), width, height


def index_within(rectangle: Rectangle, x: mi.Int32, y: mi.Int32) -> mi.UInt32:
    """Number of the pixel (x, y) in the order of :func:`pixels`."""
    left, top, width = (dr.opaque(mi.Int32, v) for v in (rectangle[0], rectangle[1], rectangle[2] - rectangle[0]))
    return mi.UInt32((y - top) * width + x - left)


def area(rectangle: Rectangle) -> int:
    """Number of the pixels of a rectangle."""
    left, top, right, bottom = rectangle
    return (right - left) * (bottom - top)


def in_patterns(plan: Plan, need: mi.Float) -> mi.UInt32:
    """Counts for the samples that are needed: those of the first wave, or whole patterns of N², within what the plan
    allows.

    N² samples that fill their pattern can be ten times as good as as many that do not, so between the two there is
    nothing; and a pattern is worth while long before all of its samples are needed.
    """
    first, enough = plan.begin or plan.least, plan.begin + WORTH_WHILE * plan.n**2
    # Opaque, as the kernel is to serve every plan.
    size, begin, first, most = (dr.opaque(mi.UInt32, v) for v in (plan.n**2, plan.begin, first, plan.most))
    enough = dr.opaque(mi.Float, max(enough, plan.least, plan.begin))
    patterns = dr.maximum(dr.round((dr.minimum(need, float(UNLIMITED)) - mi.Float(begin)) / mi.Float(size)), 1)
    counts = dr.select(need <= enough, first, begin + mi.UInt32(patterns) * size)
    return dr.minimum(counts, most)
