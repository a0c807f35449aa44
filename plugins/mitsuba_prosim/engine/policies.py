"""Policies of adaptive sampling: how many samples each pixel gets (thesis, sections 4.2.1.1 and 5.3.2)."""

from __future__ import annotations

import numpy as np

from .standard_error import in_display_units, standard_error, variance


class Policy:
    """Requests the same number of samples for every pixel; its subclasses are adaptive."""

    #: Whether each pixel gets the same number of samples.
    uniform = False
    #: Whether the policy can decide again, with other parameters, when pixels have more samples than the first ones.
    decides_again = True
    #: Whether a pixel can get more samples than the policy requests, to reach a limit of noise or time.
    unbounded = True
    #: Default maximum number of samples of a pixel, in multiples of N².
    max_patterns = 1
    #: Distance in pixels up to which the policy looks at neighbours.
    reach = 0
    #: Number of decisions of the policy, each after a pass over the image. With an error target, a policy with several
    #: decisions decides after every pass.
    rounds = 1

    def __init__(self, n: int, threshold: float, min_samples: int, noisy_samples: int, max_samples: int) -> None:
        """``n`` is the number N of samples of a pass, and ``threshold`` the integrator's parameter; the other arguments
        are numbers of samples of a pixel, see :class:`.Plan`.
        """
        self.n, self.threshold, self.noisy_samples = n, threshold, noisy_samples
        # The policy ``none`` without an error target decides nothing: the first pass takes all samples.
        #: Number of samples of every pixel in the first pass.
        self.first_samples = max_samples if self.uniform and noisy_samples == max_samples else min_samples
        # After the first pass nothing is decided, so no neighbours are needed.
        if self.first_samples >= max_samples:
            self.reach = 0

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Returns the total number of samples that each pixel should get, shape (height, width).

        For each pixel, ``total`` and ``squares`` are the sums of the luminance and of its square over ``count``
        samples; the three arrays have 64-bit floats, shape (height, width). :meth:`.Image.counts_for` later rounds
        the requested numbers up, and limits them. In this class, the result is the same number for every pixel.
        """
        return np.full(count.shape, self.noisy_samples)


class Uniform(Policy):
    """The policy ``none``, which requests the same number of samples for every pixel."""

    uniform = True


class Thesis(Policy):
    """The policy ``thesis``: a pixel gets no more samples when its standard error is at most the threshold.

    The standard error is s / sqrt(n) of the pixel's own n samples with the sample variance s², in units of radiance, as
    if they were independent; it is not that of the AOV ``error``, which compares passes. The thesis asks for an error
    below a threshold (section 4.2.1.1), and stops at the variance (section 5.3.2), as the policy ``variance`` does. The
    same samples estimate the value of a pixel and decide when the pixel is finished, so the value is biased (Kirk and
    Arvo 1991).
    """

    unbounded = False
    rounds = 1 << 32
    measure = staticmethod(standard_error)

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Requests another pass of N samples for each pixel that has too few samples, or a measure above the
        threshold. Arguments and result are those of :meth:`Policy.request`.
        """
        measured = self.measure(total, squares, count)
        done = (count % self.n == 0) & (count >= self.first_samples) & (measured <= np.float32(self.threshold))
        return np.where(done, count, (count // self.n + 1) * self.n)


class Variance(Thesis):
    """The policy ``variance``: a pixel gets no more samples when the variance of its samples is at most the threshold.

    The variance is the square of equation 4.4 of the thesis, of the pixel's own samples, in squared units of radiance.
    It does not decrease with the number of samples, so most pixels stop after the first pass or get N² samples.
    """

    @staticmethod
    def measure(total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Returns the mean squared deviation of ``count`` samples from their mean."""
        return np.maximum(squares / count - np.square(total / count), 0)


class Neighbours(Policy):
    """The policy ``neighbours``: a pixel gets all samples if the 24 pixels around it have an error above the threshold.

    The error is the standard error of the displayed value (:func:`.in_display_units`). A window of 5 x 5 pixels
    contains outliers (rare bright samples) that a window of 3 x 3 pixels misses. A window of 5 x 5 pixels also shows
    noise where the first samples of the 8 nearest pixels are equal by chance.
    """

    decides_again = False
    reach = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Requests all samples for noisy pixels, and only the samples of the first pass for other pixels.

        A pixel is noisy if its error (:func:`error_of_neighbours`) is above the threshold, or not known. Arguments and
        result are those of :meth:`Policy.request`.
        """
        # A pixel may have more samples than the first ones. The sums are scaled to ``first_samples`` samples.
        share = self.first_samples / count
        error = error_of_neighbours(total * share, squares * share, self.first_samples)
        return np.where(error <= self.threshold, self.first_samples, self.noisy_samples)  # NaN counts as noisy


class Graded(Policy):
    """The policy ``graded``: the number of samples of a pixel is in proportion to the standard deviation of a sample.

    The standard deviation of the displayed value (:func:`.in_display_units`) is estimated from the 24 pixels around the
    pixel. Numbers of samples in proportion to the standard deviation minimise the sum of the pixels' variances for a
    given total number of samples (Neyman 1934). A pixel gets N² samples if N² samples reduce the standard error to the
    threshold. The policy decides after the first and after the second pass over the image, because the few samples of
    the first pass may miss rare bright light. With a limit of noise or time, the policy decides after every pass.

    The variance of a sample is the average of two means: the mean of the variances of the 8 nearest pixels, and the
    mean of the variances of the 24 nearest pixels. So the 8 nearest pixels have more weight in the variance than the
    other 16 pixels. The geometric mean of the two means would be 0 where the 8 nearest pixels have missed all rare
    bright samples.
    """

    max_patterns = 4
    reach = 2
    rounds = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Requests samples in proportion to the standard deviation of the displayed value.

        The request is infinite for a pixel without neighbours, and where the standard deviation is not finite.
        Arguments and result are those of :meth:`Policy.request`.
        """
        # The variances within pixels. Differences between pixels may be an edge or a texture, which is no noise.
        within, means = np.float32(variance(total, squares, count)), np.float32(total / count)
        deviation = np.sqrt((mean_around(within, 1) + mean_around(within, Graded.reach)) / 2)
        # With the factor N / threshold, a deviation of N * threshold requests N² samples.
        error = in_display_units(deviation, mean_around(means, Graded.reach))
        factor = np.float32(self.n / max(self.threshold, 1e-9))
        return factor * np.where(np.isfinite(deviation), error, np.float32(np.inf))


def error_of_neighbours(total: np.ndarray, squares: np.ndarray, count: int) -> np.ndarray:
    """Returns the standard error of each pixel in display units, estimated from the 24 pixels around the pixel.

    The standard error is computed from the samples of all 24 pixels together, as if they were samples of one pixel. The
    variance of the samples of all 24 pixels also contains the differences between the means of the 24 pixels. The
    result is the error of a mean of ``count`` samples. Near the border of the arrays, a pixel has fewer than 24
    neighbours; without any neighbour, or if ``total`` is not finite for a neighbour, the error is infinite. ``total``
    and ``squares``, shape (height, width), are the sums of the luminance and of its square over the ``count`` samples
    of each pixel.
    """
    inverse = np.float32(1 / count)
    first, second = (mean_around(sums * inverse, Neighbours.reach) for sums in (total, squares))  # first two moments
    error = in_display_units(np.sqrt(np.maximum(second - np.square(first), 0) * inverse), first)
    return np.where(np.isfinite(first), error, np.inf)


def mean_around(plane: np.ndarray, reach: int) -> np.ndarray:
    """Returns, for each pixel, the mean of ``plane`` over the pixels around it, shape (height, width).

    The pixels around a pixel are the pixels within ``reach`` rows and columns, without the pixel itself. The pixel
    itself is left out, because a policy that decides by a pixel's own samples would bias the image (Kirk and Arvo
    1991). The mean is infinite for a pixel without neighbours.
    """

    def summed(plane: np.ndarray, axis: int) -> np.ndarray:
        """Returns the sums of the entries up to ``reach`` before and behind each entry along ``axis``, without it."""
        padded = np.pad(plane, [(reach * (k == axis),) * 2 for k in range(2)])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis)
        total = np.zeros_like(plane)
        for k in range(2 * reach + 1):
            total += windows[..., k] if k != reach else 0
        return total

    places = (np.arange(size) for size in plane.shape)
    rows, columns = (np.minimum(place, reach) + np.minimum(place[::-1], reach) + 1 for place in places)
    number = np.outer(rows, columns) - 1
    # The pixel's own row is added without the pixel; the other rows are added whole.
    in_row = summed(plane, 1)
    return np.where(number > 0, (in_row + summed(in_row + plane, 0)) / np.maximum(number, 1), np.float32(np.inf))


#: Allowed values of the integrator's parameter ``adaptive`` -> policy; the default is first.
POLICIES: dict[str, type[Policy]] = {
    "neighbours": Neighbours,
    "thesis": Thesis,
    "variance": Variance,
    "none": Uniform,
    "graded": Graded,
}
