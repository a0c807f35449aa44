"""Which pixels need more samples (thesis, sections 4.2.1.1 and 5.3.2)."""

import drjit as dr
import mitsuba as mi


def standard_error(total, squares, count):
    """Standard error of a mean of ``count`` samples, from their sum and their sum of squares (equation 4.4).

    Samples of one N-rook pass are stratified, so their mean is better than this says.
    """
    mean = total / count
    variance = dr.maximum(squares / count - dr.square(mean), 0) * count / dr.maximum(count - 1, 1)
    return dr.sqrt(variance / count)


def error_between_passes(total, pass_squares, passes):
    """Standard error of the mean of ``passes`` independent passes, from the sum of their means and of its squares."""
    return standard_error(total, pass_squares, passes)


def in_display_units(error, mean):
    """Error of the displayed value, by the slope of the tone curve: a square root, which is close to sRGB's."""
    return error / (2 * dr.sqrt(dr.maximum(mean, 0) + 0.01))


#: Reach of the neighbourhood: 5 x 5 pixels. Sees an outlier that 3 x 3 miss; and what is noisy is found in time, also
#: where the first samples of the very next pixels happen to agree.
REACH = 2


def error_of_neighbours(total, squares, count, width, height):
    """Standard error in display units that the 24 pixels around each pixel suggest for it.

    The pixel itself has no say: a decision by the very samples that are averaged would bias the image (Kirk and Arvo
    1991). ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, one entry a pixel,
    row by row; ``width``, ``height``: opaque integers. Beyond the border lies the mirror image.
    """
    width, height = mi.Int32(width), mi.Int32(height)
    i = dr.arange(mi.Int32, dr.width(total))
    y = i // width
    x = i - y * width
    steps = [k for k in range(-REACH, REACH + 1) if k]
    # First along the rows, then along the columns of their sums; the middle row is taken without the pixel.
    beside = [sum(dr.gather(mi.Float, values, y * width + mirror(x + k, width)) for k in steps)
              for values in (total, squares)]
    rows = [sums + values for sums, values in zip(beside, (total, squares))]
    dr.eval(beside, rows)
    first, second = (sums + sum(dr.gather(mi.Float, row, mirror(y + k, height) * width + x) for k in steps)
                     for sums, row in zip(beside, rows))
    taken = count * ((2 * REACH + 1) ** 2 - 1)
    first, second = first / taken, second / taken
    return in_display_units(dr.sqrt(dr.maximum(second - dr.square(first), 0) / count), first)


def mirror(x, size):
    """Index ``x`` brought into 0 .. ``size`` - 1 by reflection at the first and the last one."""
    return dr.clip(size - 1 - dr.abs(size - 1 - dr.abs(x)), 0, size - 1)
