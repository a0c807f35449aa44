"""One image from the first pass to the last (thesis, section 5.3.2)."""

import drjit as dr
import mitsuba as mi

from ..sampling import adaptive
from ..sampling.nrook import NRook, Permutations, grid_size, pixel_key
from ..transport.radiance import LENS, PIXEL, TIME_AND_WAVELENGTH, Transport
from .camera import ray_sampler
from .window import Image, pixels, uncropped

#: Pixels beyond the film that may have a number of their own (for films with ``sample_border``).
MARGIN = 16


class Frame:
    """One image being rendered: the film's window, the grid of samples and the steps from pass to pass."""

    def __init__(self, integrator, scene, sensor, seed, spp):
        self.integrator, self.scene, self.sensor = integrator, scene, sensor
        self.film = sensor.film()
        self.rfilter = self.film.rfilter()
        self.n = grid_size(spp) if spp else int(integrator.samples)
        most = spp or int(integrator.max_samples) or self.n ** 2
        self.most_passes = min(max(round(most / self.n), 1), self.n)
        self.first_passes = self.most_passes if integrator.adaptive == "none" \
            else min(int(integrator.min_passes), self.most_passes)
        self.permutations = Permutations(self.n)
        self.seed = dr.opaque(mi.UInt32, seed) if isinstance(seed, int) else mi.UInt32(seed)
        self.width, self.height = (int(v) for v in self.film.size())
        self.reach = self.rfilter.border_size()
        border = self.reach if self.film.sample_border() else 0
        self.domain = (-border, -border, self.width + border, self.height + border)
        self.transport = Transport(integrator, scene)
        self.threshold = dr.opaque(mi.Float, integrator.threshold)
        self.row = dr.opaque(mi.Int32, self.width + 2 * MARGIN)
        self.inverse_size = mi.Vector2f(dr.opaque(mi.Float, 1 / self.width), dr.opaque(mi.Float, 1 / self.height))

    # ------------------------------------------------------------ the samples of a pixel

    def camera_ray(self, x, y, points):
        """Camera ray through pixel (x, y): ``(ray, weight, position)``, the position being that within the pixel."""
        position = points(PIXEL)
        lens = points(LENS) if self.sensor.needs_aperture_sample() else mi.Point2f(0.5)
        moving = self.sensor.shutter_open_time() > 0
        other = points(TIME_AND_WAVELENGTH) if moving or mi.is_spectral else mi.Point2f(0.5)
        time = mi.Float(self.sensor.shutter_open())
        if moving:
            time += other.x * self.sensor.shutter_open_time()
        on_film = (mi.Point2f(mi.Float(x), mi.Float(y)) + position) * self.inverse_size
        ray, weight = self.sample_ray(time, other.y, on_film, lens)
        return ray, weight, position

    def sample(self, x, y, r, i):
        """Sample ``i`` of pass ``r`` in the pixels (x, y): ``(values, luminance, position)``, ``values`` being what the
        film stores for a sample of weight 1."""
        pixel = (y + MARGIN) * self.row + x + MARGIN
        points = NRook(self.permutations, pixel_key(self.seed, mi.UInt32(pixel)), r, i, self.integrator.jitter)
        ray, weight, position = self.camera_ray(x, y, points)
        L, hit = self.transport(ray, points, True)
        L *= weight
        # A direction at grazing incidence can overflow; one such sample must not blacken its pixel.
        L = dr.select(dr.all(dr.isfinite(L)), L, 0)
        values = self.film_values(L, ray.wavelengths, dr.select(hit, mi.Float(1), 0))
        values += self.integrator.mitsuba_aov_values(self.scene, self.sensor.sampler(), ray, True)
        return values, mi.luminance(L, ray.wavelengths), position

    def film_values(self, L, wavelengths, alpha):
        """The film's channels for a sample of weight 1."""
        film, flags = self.film, self.film.flags()
        if mi.has_flag(flags, mi.FilmFlags.Special):
            return list(film.prepare_sample(L, wavelengths, film.base_channels_count() + 1, 1.0, alpha))
        if mi.is_spectral:
            rgb = mi.spectrum_to_srgb(L, wavelengths)
        else:
            rgb = mi.Color3f(L.x) if mi.is_monochromatic else mi.Color3f(L)
        rgb = [v if name in self.integrator.channels else mi.Float(0) for name, v in zip("rgb", rgb)]
        return rgb + [alpha] * mi.has_flag(flags, mi.FilmFlags.Alpha) + [mi.Float(1)]

    def passes(self, x, y, begin, end):
        """Takes the passes ``begin`` .. ``end`` - 1 (integers) of the pixels (x, y), one lane a pixel.

        With ``adaptive`` set to ``thesis`` a pixel ends as soon as its own samples are quiet. Returns
        ``(sums, statistics, count)``: sums of the film's values for every pixel within the filter's reach, of the
        luminance, its square and the square of its mean over each pass; and the number of samples.
        """
        n, thesis = self.n, self.integrator.adaptive == "thesis"
        least = self.first_passes * n
        end = dr.opaque(mi.UInt32, end * n)

        def step(t, sums, statistics, in_pass, active):
            r = t // n
            i = t - r * n
            values, luminance, position = self.sample(x, y, r, i)
            sums = [s + w * v for s, (w, v) in zip(sums, self.spread(values, position))]
            total, squares, pass_squares = statistics
            total, squares, in_pass = total + luminance, squares + dr.square(luminance), in_pass + luminance
            last = i + 1 == n
            pass_squares += dr.select(last, dr.square(in_pass / n), 0)
            in_pass = dr.select(last, 0, in_pass)
            t += 1
            active = t < end
            if thesis:
                quiet = adaptive.standard_error(total, squares, mi.Float(t)) <= self.threshold
                active &= ~(last & (t >= least) & quiet)
            return t, sums, [total, squares, pass_squares], in_pass, active

        channels = len(self.film_channels())
        lanes = dr.width(x)
        begin = dr.opaque(mi.UInt32, begin * n)
        state = (mi.UInt32(begin), [mi.Float(0)] * (channels * (2 * self.reach + 1) ** 2), [mi.Float(0)] * 3,
                 mi.Float(0), dr.full(mi.Bool, True, lanes))
        t, sums, statistics, _, _ = dr.while_loop(
            state, lambda t, sums, statistics, in_pass, active: active, step,
            labels=("t", "sums", "statistics", "in_pass", "active"), max_iterations=-1)
        return sums, statistics, t - begin

    def film_channels(self):
        """Names of the channels that every sample has."""
        film = self.film
        others = self.integrator.mitsuba_aovs.aov_names() if self.integrator.mitsuba_aovs is not None else []
        if mi.has_flag(film.flags(), mi.FilmFlags.Special):
            return [str(k) for k in range(film.base_channels_count())] + ["W"] + list(others)
        return list("RGB") + ["A"] * mi.has_flag(film.flags(), mi.FilmFlags.Alpha) + ["W"] + list(others)

    def spread(self, values, position):
        """``(weight, value)`` for each pixel within the filter's reach, row by row, and each value."""
        if self.reach == 0:
            return [(mi.Float(1), v) for v in values]
        offsets = range(-self.reach, self.reach + 1)
        across = [self.rfilter.eval(k + 0.5 - position.x) for k in offsets]
        down = [self.rfilter.eval(k + 0.5 - position.y) for k in offsets]
        return [(wx * wy, v) for wy in down for wx in across for v in values]

    # ------------------------------------------------------------ the image

    def render(self, keep_counts=False):
        """The film's window as a tensor of shape (height, width, channels), channels weighted as a film stores them.

        ``keep_counts``: store the number of samples of each pixel in ``self.counts``, for the derivatives.
        """
        x0, y0 = (int(v) for v in self.film.crop_offset())
        width, height = (int(v) for v in self.film.crop_size())
        left, top = max(x0 - self.reach, self.domain[0]), max(y0 - self.reach, self.domain[1])
        right = min(x0 + width + self.reach, self.domain[2])
        bottom = min(y0 + height + self.reach, self.domain[3])
        rows = max(1, self.integrator.band // (right - left))
        window = (x0, y0, x0 + width, y0 + height)
        channels = self.film_channels()
        own_aovs = ["samples"] if keep_counts else self.integrator.own_aovs
        self.image = image = Image(window, channels, len(own_aovs))
        with uncropped(self.sensor):
            self.sample_ray = ray_sampler(self.sensor)
            for begin in range(top, bottom, rows):
                if self.integrator.cancelled:
                    break
                end = min(begin + rows, bottom)
                image.add(*self.render_band((left, begin, right, end), own_aovs), self.reach)
                if self.integrator.progress is not None or end < bottom:
                    image.wait()  # bounds the memory, and lets progress be true
                if self.integrator.progress is not None:
                    self.integrator.progress((end - top) / (bottom - top))
        if keep_counts:
            self.counts = image.plane(image.sampled)
        return image.tensor()

    def put(self, values):
        """Makes ``values``, as :meth:`render` returns them, what the film holds."""
        self.film.clear()
        self.film.put_block(mi.ImageBlock(values, mi.ScalarPoint2i(self.image.window[:2]), border=False))

    def render_band(self, band, own_aovs):
        """Renders the pixels of ``band`` (left, top, right, bottom).

        Returns ``(outer, band, sums / count, aovs)``, the arrays being laid out over the rectangle ``outer``.
        """
        it = self.integrator
        if it.adaptive == "neighbours" and self.first_passes < self.most_passes:
            # The neighbours around the band are taken too: samples are pure, so they are the same as in their own band.
            outer = (max(band[0] - adaptive.REACH, self.domain[0]), max(band[1] - adaptive.REACH, self.domain[1]),
                     min(band[2] + adaptive.REACH, self.domain[2]), min(band[3] + adaptive.REACH, self.domain[3]))
            x, y, width, height = pixels(outer)
            sums, statistics, count = self.passes(x, y, 0, self.first_passes)
            dr.eval(sums, statistics, count)
            error = adaptive.error_of_neighbours(statistics[0], statistics[1], mi.Float(self.first_passes * self.n),
                                                 width, height)
            left, top, right, bottom = (dr.opaque(mi.Int32, v) for v in band)
            inside = (x >= left) & (x < right) & (y >= top) & (y < bottom)
            noisy = dr.compress(inside & (error > self.threshold))
            if dr.width(noisy) > 0:
                more, more_statistics, more_count = self.passes(
                    dr.gather(mi.Int32, x, noisy), dr.gather(mi.Int32, y, noisy), self.first_passes, self.most_passes)
                dr.eval(more, more_statistics, more_count)
                for total, part in zip(sums + statistics + [count], more + more_statistics + [more_count]):
                    dr.scatter_add(total, part, noisy, mode=dr.ReduceMode.NoConflicts)
        else:
            outer = band
            x, y, *_ = pixels(band)
            sums, statistics, count = self.passes(x, y, 0, self.most_passes)
            dr.eval(sums, statistics, count)
        inverse = dr.rcp(mi.Float(count))
        own = {"samples": mi.Float(count), "error": self.error(statistics, count)}
        return outer, band, [s * inverse for s in sums], [own[name] for name in own_aovs]

    def error(self, statistics, count):
        """Standard error of the luminance of each pixel: between passes where there are two or more."""
        total, squares, pass_squares = statistics
        count = mi.Float(count)
        passes = count / self.n
        between = adaptive.error_between_passes(total / self.n, pass_squares, passes)
        return dr.select(passes > 1, between, adaptive.standard_error(total, squares, count))
