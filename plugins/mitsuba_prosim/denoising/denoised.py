"""The result of the denoiser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Factor on the upper bound of the final error. The difference of the two denoised halves does not show errors that
#: both have. Without the factor, three of six Cornell boxes with 11 samples a pixel exceeded the bound.
COMMON = 1.08


@dataclass(frozen=True)
class Denoised:
    """The denoiser's images, shape (height, width, channels), and maps of their errors, shape (height, width)."""

    #: The mean of the two halves; the output of the denoiser; and the mixture of both images.
    raw: np.ndarray
    denoised: np.ndarray
    final: np.ndarray
    #: Estimated standard error of each pixel of the raw, the denoised and the final image: RMS over the colours and the
    #: neighbourhood.
    raw_error: np.ndarray
    denoised_error: np.ndarray
    final_error: np.ndarray
    #: Estimated squared errors of the displayed luminance (white = 1) of ``raw`` and ``final``, in 64 bits. The mean
    #: over many pixels is about unbiased; single values are uncertain, and may be negative.
    raw_squares: np.ndarray
    final_squares: np.ndarray

    @property
    def raw_noise(self) -> float:
        """Estimated RMS error of the raw image's displayed luminance over all pixels (white = 1)."""
        return float(self.raw_squares.mean()) ** 0.5

    @property
    def noise(self) -> float:
        """Estimated RMS error of the final image's displayed luminance over all pixels (white = 1)."""
        return max(float(self.final_squares.mean()), 0.0) ** 0.5

    @property
    def at_most(self) -> float:
        """Upper bound of the RMS error of the displayed final image (white = 1).

        The error exceeds the bound with a probability of about 5 %: 95 % of a normal distribution are below its mean
        plus 1.645 standard deviations. The bound contains the factor :data:`COMMON`.

        At each pixel, the noise of the estimate ``final_squares`` is about the product of the noise of the two half
        images. If s² is the variance of the raw image, each half image has the variance 2 s², and the product of the
        noise of the two half images has the variance 4 s^4. ``raw_squares`` are d², where d is noise of the variance
        s²; for Gaussian noise, the mean of d^4 is 3 s^4, so 4/3 d^4 estimates 4 s^4.
        """
        deviation = float(np.sqrt(np.sum(self.raw_squares**2) * 4 / 3)) / self.raw_squares.size
        return COMMON * max(float(self.final_squares.mean()) + 1.645 * deviation, 0.0) ** 0.5
