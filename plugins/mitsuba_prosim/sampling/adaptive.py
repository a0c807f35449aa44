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


def error_of_neighbours(total, squares, count, width, height):
    """Standard error in display units that the eight neighbours of each pixel suggest for it.

    The pixel itself has no say: a decision by the very samples that are averaged would bias the image (Kirk and Arvo
    1991). ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, one entry a pixel,
    row by row; ``width``, ``height``: opaque integers. At the border the missing neighbours are those opposite.
    """
    mean, square = total / count, squares / count
    i = dr.arange(mi.UInt32, dr.width(total))
    y = i // width
    x = i - y * width
    columns = dr.select(x > 0, x - 1, dr.minimum(x + 1, width - 1)), x, dr.select(x + 1 < width, x + 1, dr.maximum(x, 1) - 1)
    rows = dr.select(y > 0, y - 1, dr.minimum(y + 1, height - 1)), y, dr.select(y + 1 < height, y + 1, dr.maximum(y, 1) - 1)
    first, second = mi.Float(0), mi.Float(0)
    for row in rows:
        for column in columns:
            if row is not y or column is not x:
                first += dr.gather(mi.Float, mean, row * width + column)
                second += dr.gather(mi.Float, square, row * width + column)
    first, second = first / 8, second / 8
    return in_display_units(dr.sqrt(dr.maximum(second - dr.square(first), 0) / count), first)
