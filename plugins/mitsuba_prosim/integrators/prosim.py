"""The stochastic ray tracer of the thesis, with adaptive N-rook sampling (chapter 4, sections 5.3 and 5.4)."""

import contextlib
import math

import drjit as dr
import mitsuba as mi

from ..parameters import reject
from ..registry import plugin
from ..sampling import adaptive
from ..sampling.nrook import JITTERS, NRook, Permutations, grid_size, pixel_key
from ..transport.radiance import DEEPEST_TREE, LENS, PIXEL, TIME_AND_WAVELENGTH, Transport

#: Pixels beyond the film that may have a number of their own (for films with ``sample_border``).
MARGIN = 16

#: Channels that say how the image was made; any other AOV is one of Mitsuba's ``aov`` integrator.
OWN_AOVS = ("samples", "error")


@plugin("integrator", "prosim")
class Prosim(mi.SamplingIntegrator):
    r"""
    .. _integrator-prosim:

    Stochastic ray tracer with adaptive N-rook sampling (:monosp:`prosim`)
    ----------------------------------------------------------------------

    .. pluginparameters::

     * - samples
       - |int|
       - :math:`N`: samples of a first pass; a pixel gets at most :math:`N^2` (Default: 5)

     * - adaptive
       - |string|
       - :monosp:`neighbours`: a pixel gets all :math:`N^2` samples where the eight pixels around it are noisy.
         :monosp:`thesis`: :math:`N` samples at a time, until the pixel's own are quiet. :monosp:`none`: always
         :math:`N^2`. (Default: :monosp:`neighbours`)

     * - threshold
       - |float|
       - Standard error that is small enough: of the displayed value, white being 1, for :monosp:`neighbours`; of
         the radiance for :monosp:`thesis` (Default: 0.006)

     * - min_passes, max_samples
       - |int|
       - Passes that every pixel gets (Default: 1) and the most samples that one may get (Default: :math:`N^2`)

     * - max_level
       - |int|
       - Deepest level of reflected and refracted rays; 0: only the first visible surface; -1: any, for paths
         (Default: 4)

     * - shadows
       - |bool|
       - Cast shadow rays (Default: |true|)

     * - ambient
       - |spectrum| or |texture|
       - Ambient intensity :math:`I_a`; a surface adds :math:`k_a I_a` (Default: 0)

     * - background
       - |spectrum| or |texture|
       - Radiance of a ray that leaves the scene. A bitmap is looked up by direction, as
         :monosp:`envmap` does, but lights nothing. (Default: 0)

     * - diffuse_bounces
       - |int|
       - Diffuse reflections that are followed. 0: none, as in the thesis; -1: every one, which is path tracing
         (Default: 0)

     * - cutoff
       - |float|
       - A branch whose throughput is not above this ends (Default: 0)

     * - rr_depth
       - |int|
       - Level from which Russian roulette ends paths; only with :monosp:`diffuse_bounces` (Default: 5)

     * - hide_emitters
       - |bool|
       - Camera rays do not see light sources (Default: |false|)

     * - jitter
       - |string|
       - Place of a sample in its cell: :monosp:`multi` or :monosp:`uniform`, see :ref:`sampler-nrook`
         (Default: :monosp:`multi`)

     * - channels
       - |string|
       - Which of r, g and b are written; the others are black (Default: :monosp:`rgb`)

     * - aovs
       - |string|
       - Further channels, separated by commas: :monosp:`samples` (per pixel), :monosp:`error` (standard error of the
         luminance), or :monosp:`name:type` as for the :monosp:`aov` integrator (Default: none)

     * - band
       - |int|
       - Pixels that are rendered at a time, which bounds the memory; it does not change the image
         (Default: 262144)

    Distributed ray tracing as the thesis has it: at the first visible surface, light from *every* source through the
    whole BRDF plus the ambient term, then both the reflected and the refracted ray, drawn from their lobes. Nothing is
    followed from a diffuse component, so caustics and diffuse interreflection are left out, unless
    :monosp:`diffuse_bounces` says otherwise. What the lobes and the sources can both sample is shared by multiple
    importance sampling, so that the expected image is the same at any roughness.

    Every space (the pixel, the lens, each source and each lobe at each node) is sampled by its own N-rook patterns.
    A sample is a pure function of seed, pixel, space, pass and index: crop windows, :monosp:`band` and the number of
    threads do not change a bit of the image. The film's reconstruction filter weights each sample by one over
    the number of samples in its pixel. The sensor's sampler is not used. A nonzero :monosp:`spp` given to ``render()``
    replaces :monosp:`max_samples`, and :monosp:`samples` by its square root, rounded up.

    In scalar variants, and nested in another integrator (:monosp:`aov`, :monosp:`moment`), every pixel gets the
    sample count of the sensor's sampler, and that sampler's samples.

    .. tabs::
        .. code-tab:: xml

            <integrator type="prosim">
                <integer name="samples" value="5"/>
                <integer name="max_level" value="3"/>
                <rgb name="ambient" value="0.1, 0.1, 0.1"/>
            </integrator>

        .. code-tab:: python

            'type': 'prosim',
            'samples': 5,
            'max_level': 3,
            'ambient': {
                'type': 'rgb',
                'value': [0.1, 0.1, 0.1]
            }
    """

    def __init__(self, props):
        super().__init__(props)
        if mi.is_polarized:
            raise ValueError("prosim: light is unpolarised here (thesis, section 2.2.3); use a variant without "
                             "'polarized'.")

        def number(name, default, least):
            value = props.get(name, default)
            if not (math.isfinite(value) and value >= least):
                raise reject(props, name, value, f"a number >= {least}")
            return value

        def choice(name, allowed):
            value = props.get(name, allowed[0])
            if value not in allowed:
                raise reject(props, name, value, " or ".join(allowed))
            return value

        self.samples = number("samples", 5, 1)
        self.adaptive = choice("adaptive", ("neighbours", "thesis", "none"))
        self.threshold = number("threshold", 0.006, 0)
        self.min_passes = number("min_passes", 1, 1)
        self.max_samples = number("max_samples", 0, 0)
        self.max_level = number("max_level", 4, -1)
        self.diffuse_bounces = number("diffuse_bounces", 0, -1)
        if self.diffuse_bounces == 0 and not 0 <= self.max_level <= DEEPEST_TREE:
            raise reject(props, "max_level", self.max_level,
                         f"0 to {DEEPEST_TREE} for a ray tree (-1, any level, goes with diffuse_bounces)")
        self.shadows = props.get("shadows", True)
        self.ambient = props.get_emissive_texture("ambient") if "ambient" in props else None
        self.background = props.get_emissive_texture("background") if "background" in props else None
        self.cutoff = number("cutoff", 0.0, 0)
        self.rr_depth = number("rr_depth", 5, 0)
        self.hides_emitters = props.get("hide_emitters", False)
        self.jitter = choice("jitter", JITTERS)
        self.channels = props.get("channels", "rgb").lower()
        if set(self.channels) - set("rgb"):
            raise reject(props, "channels", self.channels, "some of the letters r, g, b")
        self.band = int(number("band", 1 << 18, 1))
        self.own_aovs, self.mitsuba_aovs = [], None
        others = []
        for aov in filter(None, (a.strip() for a in props.get("aovs", "").split(","))):
            if aov in OWN_AOVS:
                self.own_aovs.append(aov)
            elif ":" in aov:
                others.append(aov)
            else:
                raise reject(props, "aovs", aov, ", ".join(OWN_AOVS) + " or name:type as for the aov integrator")
        if others:
            self.mitsuba_aovs = mi.load_dict({"type": "aov", "aovs": ",".join(others)})
        #: Called with the part done, 0 to 1, while an image is rendered.
        self.progress = None
        self.frame = None
        self.cancelled = False

    def traverse(self, callback):
        for name in ("ambient", "background"):
            if getattr(self, name) is not None:
                callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def to_string(self):
        names = ("samples", "adaptive", "threshold", "max_level", "diffuse_bounces", "shadows", "jitter")
        return "Prosim[\n" + ",\n".join(f"  {name} = {getattr(self, name)}" for name in names) + "\n]"

    def aov_names(self):
        others = self.mitsuba_aovs.aov_names() if self.mitsuba_aovs is not None else []
        return list(others) + self.own_aovs

    def cancel(self):
        """Ends a rendering in progress after the current band; the film keeps what was finished."""
        self.cancelled = True

    def flush(self):
        """Puts the image so far into the film; for ``progress`` to call."""
        self.frame.put(self.frame.image.tensor())

    def background_radiance(self, ray, si, active):
        """Radiance of the background in the direction of ``ray``."""
        d = ray.d
        si = mi.SurfaceInteraction3f(si)  # whoever called still needs its own uv
        # Latitude and longitude as Mitsuba's envmap has them: y is up, u = 0 towards +z.
        u = dr.atan2(d.x, -d.z) * dr.inv_two_pi
        si.uv = mi.Point2f(u - dr.floor(u), dr.safe_acos(d.y) * dr.inv_pi)
        return self.background.eval(si, active)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        transport = Transport(self, scene)
        L, hit = transport(ray, SamplerPoints(sampler), active, sampler)
        aovs = self._mitsuba_aovs(scene, sampler, ray, active) + [mi.Float(0)] * len(self.own_aovs)
        return L, hit, aovs

    def _mitsuba_aovs(self, scene, sampler, ray, active):
        if self.mitsuba_aovs is None:
            return []
        return list(self.mitsuba_aovs.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)[2])

    # ---------------------------------------------------------------- rendering

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if not dr.is_jit_v(mi.Float):
            return super().render(scene, sensor, seed, spp, develop, evaluate)
        self.cancelled = False
        film = sensor.film()
        film.prepare(self.aov_names())
        self.frame = Frame(self, scene, sensor, seed, spp)
        self.frame.put(self.frame.render())
        self.frame = None
        image = film.develop() if develop else mi.TensorXf()
        if evaluate:
            dr.eval(image)
            if not develop:
                film.schedule_storage()
                dr.eval()
            dr.sync_thread()
        return image

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        frame, _ = self._differentiable_frame(scene, sensor, seed, spp)
        image = frame.develop(frame.attached_storage())
        dr.forward_to(image)
        return mi.TensorXf(dr.grad(image))

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        frame, storage = self._differentiable_frame(scene, sensor, seed, spp)
        dr.enable_grad(storage)
        dr.backward(dr.sum(frame.develop(storage) * grad_in, axis=None))
        frame.backward(dr.grad(storage))

    def _differentiable_frame(self, scene, sensor, seed, spp):
        """A frame whose samples are counted, and the values of its film, without derivatives."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        self.cancelled = False
        with dr.suspend_grad():
            frame = Frame(self, scene, sensor, seed, spp)
            storage = frame.render(keep_counts=True)
        frame.transport = Transport(self, scene, attached=True)
        return frame, storage


class SamplerPoints:
    """The samples of a Mitsuba sampler in the place of :class:`NRook`; the spaces are taken as they come."""

    def __init__(self, sampler):
        self.sampler = sampler

    def __call__(self, space, active=True):
        return self.sampler.next_2d(active)

    def choice(self, space):
        return self.sampler.next_1d()


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
        self.size = mi.ScalarVector2u(self.width, self.height)
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
        ray, weight = self.sensor.sample_ray(time, other.y, on_film, lens)
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
        values += self.integrator._mitsuba_aovs(self.scene, self.sensor.sampler(), ray, True)
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
            self.counts = image.values.pop()
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
            outer = (max(band[0] - 1, self.domain[0]), max(band[1] - 1, self.domain[1]),
                     min(band[2] + 1, self.domain[2]), min(band[3] + 1, self.domain[3]))
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

    # ------------------------------------------------------------ derivatives, by the same samples

    def develop(self, storage):
        """The developed image of film values ``storage``, differentiably."""
        self.film.prepare(self.integrator.aov_names()[:storage.shape[2] - self.film_channels().index("W") - 1])
        self.film.put_block(mi.ImageBlock(storage, mi.ScalarPoint2i(self.film.crop_offset()), border=False))
        return self.film.develop()

    def samples_with_gradients(self):
        """Yields ``(values, weights, pixel)`` for each pass: the film's values of one sample a lane, with derivatives;
        and for each pixel of the window within the filter's reach the weight of the sample and the pixel's index."""
        x0, y0 = (int(v) for v in self.film.crop_offset())
        width, height = (int(v) for v in self.film.crop_size())
        x, y, *_ = pixels((x0, y0, x0 + width, y0 + height))
        with uncropped(self.sensor):
            for r in range(self.most_passes):
                taken = dr.compress(self.counts > r * self.n + 0.5)
                if dr.width(taken) == 0:
                    break
                lane = dr.arange(mi.UInt32, dr.width(taken) * self.n)
                pixel = dr.gather(mi.UInt32, taken, lane // self.n)
                px, py = dr.gather(mi.Int32, x, pixel), dr.gather(mi.Int32, y, pixel)
                values, _, position = self.sample(px, py, dr.opaque(mi.UInt32, r), lane % self.n)
                share = dr.rcp(dr.gather(mi.Float, self.counts, pixel))
                spread = []
                for k, (weight, _) in enumerate(self.spread([mi.Float(1)], position)):
                    tx = px - x0 + k % (2 * self.reach + 1) - self.reach
                    ty = py - y0 + k // (2 * self.reach + 1) - self.reach
                    there = (tx >= 0) & (tx < width) & (ty >= 0) & (ty < height)
                    spread.append((dr.select(there, weight * share, 0), mi.UInt32(dr.select(there, ty * width + tx, 0))))
                yield values, spread

    def backward(self, gradient):
        """Propagates the derivative with respect to the film's values to the scene's parameters."""
        channels = gradient.shape[2]
        gradient = gradient.array
        for values, spread in self.samples_with_gradients():
            loss = mi.Float(0)
            for c, value in enumerate(values):
                if dr.grad_enabled(value):
                    loss += value * sum(w * dr.gather(mi.Float, gradient, p * channels + c) for w, p in spread)
            # The passes share the graph behind the scene's parameters: its edges must stay.
            dr.backward(dr.sum(loss), flags=dr.ADFlag.ClearVertices)

    def attached_storage(self):
        """The film's values as a tensor that depends on the scene's parameters."""
        width, height = (int(v) for v in self.film.crop_size())
        channels = len(self.film_channels())
        total = dr.zeros(mi.Float, width * height * channels)
        for values, spread in self.samples_with_gradients():
            for c, value in enumerate(values):
                for w, p in spread:
                    dr.scatter_add(total, w * value, p * channels + c)
        return mi.TensorXf(total, (height, width, channels))


class Image:
    """The window of a film, as sums of weighted values that bands are added to from top to bottom.

    Each pixel gathers what the samples around it have for it, row after row, so that the sum has one order, whatever
    the bands are.
    """

    def __init__(self, window, channels, aovs):
        self.window, self.channels, self.weight = window, len(channels), channels.index("W")
        self.width, self.height = window[2] - window[0], window[3] - window[1]
        self.values = [dr.zeros(mi.Float, self.width * self.height) for _ in range(self.channels + aovs)]
        dr.make_opaque(self.values)

    def add(self, outer, band, sums, aovs, reach):
        """Adds the pixels of ``band``; ``sums`` and ``aovs`` are laid out over the rectangle ``outer``."""
        top, bottom = max(band[1] - reach, self.window[1]), min(band[3] + reach, self.window[3])
        if top >= bottom:
            return
        x, y, *_ = pixels((self.window[0], top, self.window[2], bottom))
        index = mi.UInt32((y - dr.opaque(mi.Int32, self.window[1])) * dr.opaque(mi.Int32, self.width)
                          + x - dr.opaque(mi.Int32, self.window[0]))
        totals = [dr.gather(mi.Float, v, index) for v in self.values[:self.channels]]
        left, first, right, last = (dr.opaque(mi.Int32, v) for v in band)
        outer_left, outer_top, outer_width = (dr.opaque(mi.Int32, v) for v in (outer[0], outer[1], outer[2] - outer[0]))
        offsets = range(-reach, reach + 1)
        dr.eval(sums, aovs)
        for dy in reversed(offsets):
            for dx in reversed(offsets):
                sx, sy = x - dx, y - dy
                there = (sx >= left) & (sx < right) & (sy >= first) & (sy < last)
                source = mi.UInt32((sy - outer_top) * outer_width + sx - outer_left)
                place = ((dy + reach) * (2 * reach + 1) + dx + reach) * self.channels
                for c in range(self.channels):
                    totals[c] += dr.gather(mi.Float, sums[place + c], source, there)
        own = (y >= first) & (y < last)
        source = mi.UInt32((y - outer_top) * outer_width + x - outer_left)
        for c, total in enumerate(totals):
            dr.scatter(self.values[c], total, index)
        for c, aov in enumerate(aovs):
            dr.scatter(self.values[self.channels + c], dr.gather(mi.Float, aov, source, own), index, own)

    def wait(self):
        """Waits until what was added is there."""
        dr.eval(self.values)
        dr.sync_thread()

    def tensor(self):
        """Shape (height, width, channels), the integrator's own channels multiplied by the weight, as films expect."""
        channels = self.values[:self.channels]
        channels = channels + [v * self.values[self.weight] for v in self.values[self.channels:]]
        flat = dr.zeros(mi.Float, self.width * self.height * len(channels))
        index = dr.arange(mi.UInt32, self.width * self.height) * len(channels)
        for c, values in enumerate(channels):
            dr.scatter(flat, values, index + c)
        return mi.TensorXf(flat, (self.height, self.width, len(channels)))


def pixels(rectangle):
    """``(x, y, width, height)``: the pixels of a rectangle (left, top, right, bottom), row by row, and its size."""
    left, top, right, bottom = rectangle
    width, height = dr.opaque(mi.UInt32, right - left), dr.opaque(mi.UInt32, bottom - top)
    i = dr.arange(mi.UInt32, (right - left) * (bottom - top))
    y = i // width
    x = i - y * width
    return mi.Int32(x) + dr.opaque(mi.Int32, left), mi.Int32(y) + dr.opaque(mi.Int32, top), width, height


@contextlib.contextmanager
def uncropped(sensor):
    """The film of ``sensor`` without its crop window, so that the rays of a crop are those of the whole image to the
    bit (a sensor scales positions by the window)."""
    film = sensor.film()
    offset, size = mi.ScalarPoint2u(film.crop_offset()), mi.ScalarVector2u(film.crop_size())
    if all(offset == 0) and all(size == film.size()):
        yield
        return
    params = mi.traverse(sensor)
    try:
        params["film.crop_offset"], params["film.crop_size"] = mi.ScalarPoint2u(0), mi.ScalarVector2u(film.size())
        params.update()
        yield
    finally:
        params["film.crop_offset"], params["film.crop_size"] = offset, size
        params.update()
