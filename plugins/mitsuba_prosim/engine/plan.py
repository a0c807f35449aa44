"""The plan of an image: the pixels, the sample points, and how many samples a pixel gets (thesis, section 5.3.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..compat import dr_array
from ..parameters import check_seed
from ..sampling.nrook import NRook, Permutations, grid_size, pixel_key
from ..sampling.sobol import Sobol, z_curve

if TYPE_CHECKING:
    from .policies import Policy

#: Left, top, right and bottom, in pixels of the whole film.
Rectangle = tuple[int, int, int, int]


#: Default maximum number of samples of a pixel, if a limit of noise or time ends the render.
UNLIMITED = 1 << 20
#: Numbers of samples of a pixel with which the pixels share one sequence.
SHARED = (1, 2, 4, 8, 16)
#: Parameters of the integrator that end a render.
TARGETS = ("noise", "noise_99", "time")


@dataclass(frozen=True)
class Sampling:
    """The sampling parameters of an integrator; the plugin page :ref:`integrator-prosim` explains each of them."""

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
    def n(self) -> int:
        """The number N of samples of a pass: ``samples``, or a lower maximum."""
        return min(self.samples, self.max_samples or self.samples)

    @property
    def noises(self) -> tuple[float, float]:
        """Limits of the RMS error, and of the errors of 99 % of the pixels; 0 means no limit."""
        return self.noise, self.noise_99

    @property
    def has_target(self) -> bool:
        """Whether the parameters set a limit of noise or of time, which ends the render."""
        return any(self.noises) or self.time > 0

    def uniform(self, spp: int) -> Sampling:
        """Returns the parameters with which each pixel gets ``spp`` samples, without limits of noise or time."""
        unlimited = replace(self, noise=0, noise_99=0, time=0)
        return replace(unlimited, samples=grid_size(spp), max_samples=spp, adaptive="none")

    def halved(self) -> Sampling:
        """Returns the parameters for each of two images that together take about as many samples as one image.

        The parameter ``max_samples`` is halved and rounded up; 0 (no maximum) stays 0. If a limit of noise or time is
        set, the parameter ``samples`` is not halved, because a second image may not be needed. Without a limit of noise
        or time, the parameter ``threshold`` is multiplied by the square root of 2, because the mean of both images has
        half the variance of one image.
        """
        half = replace(self, max_samples=(self.max_samples + 1) // 2)
        if not self.has_target:
            # N for an N-rook pattern of about half as many samples, N².
            half = replace(half, samples=max(1, round(self.samples / 2**0.5)), threshold=self.threshold * 2**0.5)
        return half


#: Names of the parameters of sampling.
SAMPLING = tuple(field.name for field in fields(Sampling))


@dataclass(frozen=True)
class Plan:
    """The plan of one image: the pixels, the sample points, and how many samples a pixel gets.

    By default, the sample points are the N-rook patterns of the thesis, which have at most N² samples per pixel. The
    sample points are Owen-scrambled Sobol' points, whose number is unlimited, if a pixel may get more than N² samples,
    if ``spp`` or a limit of noise or time is set, or with the policy ``graded``.

    If ``spp`` is 1, 2, 4, 8 or 16, and every pixel gets this number of samples, all pixels share one Sobol' sequence,
    in the order of a Z-shaped curve through the image (Ahmed and Wonka 2020, Screen-space blue-noise diffusion of Monte
    Carlo sampling error). With the shared sequence, a single pixel is as noisy as with a sequence of its own, but the
    mean of neighbouring pixels is less noisy. In spectral variants, pixels share no sequence.
    """

    #: The number N of samples of a pass.
    n: int
    #: Minimum number of samples of a pixel; number of samples of a pixel above the threshold; maximum number of
    #: samples.
    min_samples: int
    noisy_samples: int
    max_samples: int
    #: Whether the points are Sobol' points.
    uses_sobol: bool
    #: Number of the first samples of a pixel for which all pixels share one Sobol' sequence.
    shared: int
    permutations: Permutations
    seed: mi.UInt32
    #: The film's crop window.
    window: Rectangle
    #: The pixels that have samples: those of the film, and those beyond it within the filter's reach if the film
    #: samples its border.
    domain: Rectangle
    #: The pixels whose samples reach the crop window through the reconstruction filter.
    region: Rectangle
    #: The parameters of sampling.
    sampling: Sampling
    #: Seed of the photons, for all pixels.
    photon_seed: int

    @classmethod
    def of(cls, sampling: Sampling, film: mi.Film, seed: int | mi.UInt32, spp: int, n: int = 0) -> Plan:
        """Returns the plan for an image on ``film`` with the parameters ``sampling`` and the random ``seed``.

        A nonzero ``n`` is the N of the image's earlier passes, which may have had another maximum. A nonzero ``spp`` is
        the number of samples of each pixel; ``sampling`` must then be the result of
        :meth:`Sampling.uniform`. If the parameter ``max_samples`` is 0, the maximum number of samples of a pixel is
        :data:`UNLIMITED` with a limit of noise or time, and else :attr:`.Policy.max_patterns` times N².
        """
        from .policies import POLICIES  # slow to import, and only a render needs NumPy

        policy, noisy = POLICIES[sampling.adaptive], sampling.samples**2
        n, least = n or sampling.n, sampling.min_passes * sampling.n
        if sampling.has_target:
            highest = sampling.max_samples or UNLIMITED
            least = 1 << (least.bit_length() - 1)  # a power of two, for which Sobol' points are best
        else:
            highest = sampling.max_samples or policy.max_patterns * noisy
            noisy = noisy if policy.max_patterns > 1 else highest
        x, y, w, h, width, height = map(int, (*film.crop_offset(), *film.crop_size(), *film.size()))
        reach = film.rfilter().border_size()
        border = reach if film.sample_border() else 0
        window, domain = (x, y, x + w, y + h), (-border, -border, width + border, height + border)
        seed = mi.UInt32(check_seed(seed))
        dr.make_opaque(seed)  # a constant seed would be a part of the kernel
        least = min(least, highest)
        # Pixels that share one sequence have dependent samples. A policy that decides by neighbours needs independent
        # samples, so pixels share a sequence only if every pixel gets the same number of samples.
        uniform = not sampling.has_target and (policy.uniform or least == highest)
        shares = uniform and spp in SHARED and not mi.is_spectral
        return cls(
            n=n,
            min_samples=least,
            noisy_samples=min(noisy, highest),
            max_samples=highest,
            uses_sobol=bool(spp) or sampling.has_target or policy.max_patterns > 1 or highest > n * n,
            shared=spp if shares else 0,
            permutations=Permutations(n),
            seed=seed,
            window=window,
            domain=domain,
            region=widened(window, reach, domain),
            sampling=sampling,
            photon_seed=int(seed[0]),
        )

    @property
    def policy(self) -> Policy:
        """The policy of adaptive sampling."""
        from .policies import POLICIES

        numbers = self.min_samples, self.noisy_samples, self.max_samples
        return POLICIES[self.sampling.adaptive](self.sampling.n, self.sampling.threshold, *numbers)

    def points(self, x: mi.Int32, y: mi.Int32, t: mi.UInt32) -> NRook | Sobol:
        """Returns the ``t``-th sample point of the pixels (x, y).

        Call the result with the number of a space (a pair of random numbers of a sample), such as ``PIXEL`` or
        ``LENS``, to get the two coordinates, in [0, 1), of the point in this space. The sample point depends only on
        the plan, the pixel and ``t``.
        """
        # Each coordinate has 16 bits, so that the samples of a pixel do not depend on the film's size.
        pixel = (mi.UInt32(y) << 16) | (mi.UInt32(x) & 0xFFFF)
        # Sobol' points: the first ``shared`` samples of a pixel come from the sequence that all pixels share, in the
        # order of the Z curve; later samples come from the pixel's own sequence. Both cases use the same kernel. The
        # last argument of ``Sobol`` is the number of samples that together cover the spectrum.
        if self.uses_sobol:
            shared = dr.opaque(mi.UInt32, self.shared)
            shares = t < shared
            first = dr.select(shares, z_curve(x, y) * shared, 0)
            return Sobol(pixel_key(self.seed, dr.select(shares, 0, pixel)), t, dr.opaque(mi.UInt32, self.n), first)
        return NRook(self.permutations, pixel_key(self.seed, pixel), t, self.sampling.jitter)


def widened(rectangle: Rectangle, reach: int, domain: Rectangle) -> Rectangle:
    """Returns ``rectangle`` enlarged by ``reach`` pixels on each side, but not beyond the rectangle ``domain``."""
    return (
        max(rectangle[0] - reach, domain[0]),
        max(rectangle[1] - reach, domain[1]),
        min(rectangle[2] + reach, domain[2]),
        min(rectangle[3] + reach, domain[3]),
    )


def pixels(rectangle: Rectangle) -> tuple[mi.Int32, mi.Int32]:
    """Returns ``(x, y)``: the coordinates of the pixels of a rectangle (left, top, right, bottom), row by row."""
    import numpy as np  # slow to import, and only a render needs NumPy

    left, top, right, bottom = rectangle
    x, y = np.meshgrid(np.arange(left, right, dtype=np.int32), np.arange(top, bottom, dtype=np.int32))
    return dr_array(x), dr_array(y)


def indexer(inside: Rectangle, stored: Rectangle) -> Callable[[mi.Int32, mi.Int32], tuple[mi.UInt32, mi.Bool]]:
    """Returns a function that converts coordinates (x, y) of pixels to ``(index, active)``.

    ``active`` tells whether the pixel is in the rectangle ``inside``. For a pixel in ``inside``, ``index`` is its index
    among the :func:`pixels` of the rectangle ``stored``, which must contain ``inside``; for other pixels, ``index`` has
    no meaning.
    """
    width = stored[2] - stored[0]
    first = stored[1] * width + stored[0]
    # The numbers are opaque, so that one kernel serves all rectangles.
    left, top, right, bottom, width, first = (dr.opaque(mi.Int32, v) for v in (*inside, width, first))

    def index(x: mi.Int32, y: mi.Int32) -> tuple[mi.UInt32, mi.Bool]:
        return mi.UInt32(y * width + x - first), (x >= left) & (x < right) & (y >= top) & (y < bottom)

    return index


def area(rectangle: Rectangle) -> int:
    """Returns the number of pixels of a rectangle."""
    left, top, right, bottom = rectangle
    return (right - left) * (bottom - top)
