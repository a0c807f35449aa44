"""Plugins that users write in Python: what Mitsuba accepts, ``prosim`` and ``prosim_adaptive`` render equally. The
plugins may ignore the type mask, leave the type of samples 0, lack optional methods, and return numbers of Python.
"""

import drjit as dr
import mitsuba as mi
import mitsuba_prosim
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim.scene.rendering import progressive
from scenes import T, camera, film, rectangle, sphere_lamp

PATHS = {"type": "prosim", "max_level": -1, "diffuse_bounces": -1}
#: The light of sources at the first surface, as a tree and as a path.
TREE, FIRST = {"type": "prosim", "max_level": 0}, {"type": "path", "max_depth": 2}
WHOLE = {"type": "path", "rr_depth": 100}
EXPONENT = 20


def two_lobes(typed, ideal):
    """The class of a BSDF with a diffuse lobe and a glossy or ``ideal`` one; its samples have types if ``typed``."""
    front, names = mi.BSDFFlags.FrontSide, mi.BSDFFlags
    kinds = [names.DiffuseReflection, names.DeltaReflection if ideal else names.GlossyReflection]

    class TwoLobes(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.m_components = [kind | front for kind in kinds]
            self.m_flags = kinds[0] | kinds[1] | front

        def traverse(self, callback):
            callback.put("itself", self, mi.ParamFlags.NonDifferentiable)

        def sample(self, ctx, si, sample1, sample2, active):
            mirrored, specular, bs = mi.reflect(si.wi), sample1 < 0.5, dr.zeros(mi.BSDFSample3f)
            cos, phi = (1 - sample2.y) ** (1 / (EXPONENT + 1)), dr.two_pi * sample2.x
            sin = dr.safe_sqrt(1 - dr.square(cos))
            narrow = mi.Frame3f(mirrored).to_world(mi.Vector3f(sin * dr.cos(phi), sin * dr.sin(phi), cos))
            wide = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.wo, bs.eta = dr.select(specular, mirrored if ideal else narrow, wide), 1.0
            bs.sampled_component = dr.select(specular, mi.UInt32(1), 0)
            if typed:
                bs.sampled_type = dr.select(specular, mi.UInt32(int(kinds[1])), int(kinds[0]))
            value, bs.pdf = self.eval(ctx, si, bs.wo, active), self.pdf(ctx, si, bs.wo, active)
            if ideal:
                value, bs.pdf = dr.select(specular, 0.3, value), dr.select(specular, 0.5, bs.pdf)
            valid = active & (si.wi.z > 0) & (bs.pdf > 0)
            return bs, dr.select(valid, value / dr.select(valid, bs.pdf, 1), 0)

        def densities(self, si, wo):
            cos = dr.maximum(dr.dot(mi.reflect(si.wi), wo), 0)
            return wo.z * dr.inv_pi, 0 if ideal else (EXPONENT + 1) * dr.inv_two_pi * cos**EXPONENT

        def eval(self, ctx, si, wo, active):
            diffuse, glossy = self.densities(si, wo)
            valid = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(valid, mi.Color3f(0.5, 0.3, 0.2) * diffuse + 0.4 * wo.z * glossy, 0)

        def pdf(self, ctx, si, wo, active):
            diffuse, glossy = self.densities(si, wo)
            return dr.select(active & (si.wi.z > 0) & (wo.z > 0), 0.5 * (diffuse + glossy), 0)

        def eval_pdf(self, ctx, si, wo, active):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    return TwoLobes


class Glass(mi.llvm_ad_rgb.BSDF):
    """The glass of Mitsuba's tutorial, whose value and density are numbers of Python."""

    def __init__(self, props):
        super().__init__(props)
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DeltaReflection | sides, mi.BSDFFlags.DeltaTransmission | sides]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def sample(self, ctx, si, sample1, sample2, active):
        reflectance, cos, eta, inverse = mi.fresnel(si.wi.z, 1.33)
        reflects, bs = sample1 <= reflectance, dr.zeros(mi.BSDFSample3f)
        bs.pdf, bs.eta = dr.select(reflects, reflectance, 1 - reflectance), dr.select(reflects, 1, eta)
        bs.wo = dr.select(reflects, mi.reflect(si.wi), mi.refract(si.wi, cos, inverse))
        kinds = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
        bs.sampled_type = dr.select(reflects, *(mi.UInt32(int(kind)) for kind in kinds))
        return bs, mi.Color3f(1) & active

    def eval(self, ctx, si, wo, active):
        return 0.0

    def pdf(self, ctx, si, wo, active):
        return 0.0

    def eval_pdf(self, ctx, si, wo, active):
        return 0.0, 0.0

    def traverse(self, callback):
        callback.put_parameter("eta", 1.33, mi.ParamFlags.NonDifferentiable)  # of Mitsuba 3.0 to 3.6


def scene(bsdf, **lamps):
    """A ball with the BSDF, between a floor and ``lamps``, beside a surface that samples all its lobes together."""
    return {
        "type": "scene",
        "sensor": camera([0, 1, 6], [0, 0, 0], film(16), fov=40),
        "floor": rectangle(T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)),
        "ball": {"type": "sphere", "bsdf": bsdf},
        "other": {"type": "sphere", "center": [2, 0, 0], "bsdf": {"type": "principled", "roughness": 0.4}},
        **(lamps or {"lamp": sphere_lamp([0, 5, 2], 0.5, 30.0)}),
    }


def compared(scene, ours, reference):
    return same_expectation(renderings(scene, 8, 256, **reference), renderings(scene, 8, 128, first_seed=50, **ours))


#: A tree follows rays through holes; Mitsuba's ``path`` loses the light of paths through a hole (prosim check path).
HOLES = "mask", PATHS, WHOLE | {"type": "prb"}
TWO_SIDED = [("twosided", *how) for how in ((TREE, FIRST), (PATHS, WHOLE))]


@pytest.mark.slow
@pytest.mark.parametrize("wrapper, ours, reference", [(None, TREE, FIRST), (None, PATHS, WHOLE), *TWO_SIDED, HOLES])
def test_lobes_of_a_users_bsdf_count_once(variant_rgb, wrapper, ours, reference):
    """Also if the BSDF ignores the type mask, and leaves ``sampled_type`` 0; that of a second ball does not."""
    bsdfs = []
    for typed in False, True:
        mi.register_bsdf(name := f"users_{typed}", two_lobes(typed, ideal=False))
        how = {"type": wrapper, "nested": {"type": name}} if wrapper else {"type": name}
        bsdfs.append(how | ({"opacity": 0.6} if wrapper == "mask" else {}))
    room = scene(bsdfs[0]) | {"second": {"type": "sphere", "center": [-2, 0, 0], "bsdf": bsdfs[1]}}
    assert compared(room, ours, reference)


@pytest.mark.slow
@pytest.mark.parametrize("point", [False, True])
def test_users_bsdf_with_a_mirror_or_glass(variant_rgb, point):
    """Beside a point, the value of glossy lobes is asked for before the render."""
    lamps = {"lamp": {"type": "point", "position": [0, 4, 4], "intensity": 20.0}} if point else {}
    mi.register_bsdf("users_mirror", two_lobes(True, ideal=True))
    mi.register_bsdf("users_gloss", two_lobes(True, ideal=False))
    mi.register_bsdf("users_glass", Glass)
    for name in ("mirror", "gloss", "glass"):
        assert compared(scene({"type": f"users_{name}"}, **lamps), PATHS, WHOLE)


class Stripes(mi.llvm_ad_rgb.Texture):
    """A texture with the methods that ``diffuse`` calls: ``max`` and ``is_spatially_varying`` are missing."""

    def eval(self, si, active):
        return mi.Color3f(0.5 + 0.4 * dr.sin(30 * si.uv.x))


@pytest.mark.slow
def test_users_texture_in_materials(variant_rgb):
    mi.register_texture("users_stripes", Stripes)
    stripes = {"type": "users_stripes"}
    ours = scene({"type": "prosim_lambertian", "reflectance": stripes})
    theirs = renderings(scene({"type": "diffuse", "reflectance": stripes}), 8, 256, **WHOLE)
    assert same_expectation(theirs, renderings(ours, 8, 128, first_seed=50, **PATHS))
    for name in "conductor", "dielectric", "composite", "phong":
        parameter = "specular_reflectance" if name in ("conductor", "dielectric") else "diffuse_reflectance"
        mi.load_dict({"type": f"prosim_{name}", parameter: stripes})


class Spread(mi.llvm_ad_rgb.Texture):
    """Light that depends on the direction, as the spread of a lamp does."""

    def eval(self, si, active):
        return mi.Color3f(0.8, 0.6, 0.4) * si.wi.z


def test_users_texture_of_a_lamp_may_depend_on_the_direction(variant_rgb):
    """Mitsuba's ``area`` samples it with the direction 0, and so is dark."""
    mi.register_texture("users_spread", Spread)
    lamp = mi.load_dict(rectangle(T(), emitter={"type": "prosim_area", "radiance": {"type": "users_spread"}}))
    it = dr.zeros(mi.SurfaceInteraction3f)
    it.p = mi.Point3f(0.3, 2, 3)
    ds, weight = lamp.emitter().sample_direction(it, mi.Point2f(0.2, 0.7))
    assert dr.allclose(weight * ds.pdf, mi.Color3f(0.8, 0.6, 0.4) * -ds.d.z) and weight.x[0] > 0


class Lamp(mi.llvm_ad_rgb.Emitter):
    """A surface with a light that depends on the direction, and if it ``varies`` on the place, which its flags do not
    tell.
    """

    def __init__(self, props):
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.Surface
        self.varies = props.get("varies", False)

    def radiance(self, cos, uv):
        return mi.Color3f(20, 15, 10) * (cos * cos * (uv.x if self.varies else 1))

    def eval(self, si, active):
        return dr.select(active & (si.wi.z > 0), self.radiance(si.wi.z, si.uv), 0)

    def sample_direction(self, it, sample, active):
        ds = self.get_shape().sample_direction(it, sample, active)
        ds.emitter = mi.EmitterPtr(self)
        cos = -dr.dot(ds.d, ds.n)
        return ds, dr.select(active & (cos > 0), self.radiance(cos, ds.uv) / ds.pdf, 0)

    def pdf_direction(self, it, ds, active):
        return dr.select(dr.dot(ds.d, ds.n) < 0, self.get_shape().pdf_direction(it, ds, active), 0)

    def traverse(self, callback):
        callback.put_parameter("varies", self.varies, mi.ParamFlags.NonDifferentiable)  # of Mitsuba 3.0 to 3.6


class Sky(mi.llvm_ad_rgb.Emitter):
    """Light from all around, of which it samples that from above alone: the rays of a path find the rest."""

    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.Infinite

    def eval(self, si, active):
        return dr.select(active, mi.Color3f(0.4, 0.3, 0.2) * dr.select(si.wi.y < 0, 1, mi.Float(2)), 0)

    def sample_direction(self, it, sample, active):
        local, ds = mi.warp.square_to_cosine_hemisphere(sample), dr.zeros(mi.DirectionSample3f)
        ds.d = mi.Vector3f(local.x, local.z, local.y)
        ds.dist, ds.n, ds.time, ds.emitter = mi.Float(100), -ds.d, it.time, mi.EmitterPtr(self)
        ds.p, ds.pdf = it.p + ds.d * ds.dist, self.pdf_direction(it, ds, active)
        return ds, mi.Color3f(0.4, 0.3, 0.2) / ds.pdf & active

    def pdf_direction(self, it, ds, active):
        return dr.maximum(ds.d.y, 1e-8) * dr.inv_pi


class Point(mi.llvm_ad_rgb.Emitter):
    """A point, with numbers of Python."""

    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.DeltaPosition

    def eval(self, si, active):
        return 0.0

    def sample_direction(self, it, sample, active):
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p, ds.pdf, ds.time, ds.delta, ds.emitter = mi.Point3f(3, 3, 2), 1.0, it.time, True, mi.EmitterPtr(self)
        ds.dist = dr.norm(ds.p - it.p)
        ds.d = (ds.p - it.p) / ds.dist
        return ds, dr.select(active, mi.Color3f(9) / dr.square(ds.dist), 0)

    def pdf_direction(self, it, ds, active):
        return 0.0

    def sample_ray(self, time, sample1, sample2, active):
        """One argument is missing, and nobody has noticed, because Mitsuba's ``path`` does not need rays."""

    def bbox(self):
        return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(3, 3, 2))


@pytest.mark.slow
@pytest.mark.parametrize("ours, reference", [(TREE, FIRST), (PATHS, WHOLE)], ids=["tree", "paths"])
@pytest.mark.parametrize("lamps", [("lamp", "point", "ball"), ("lamp",), ("sky",)])
def test_users_lamps(variant_rgb, lamps, ours, reference):
    """Without ``eval_direction``, with or without other lamps, on a sphere and on a rectangle."""
    mi.register_emitter("users_lamp", Lamp)
    mi.register_emitter("users_point", Point)
    mi.register_emitter("users_sky", Sky)
    things = {
        "lamp": {"type": "sphere", "center": [0, 4, 2], "radius": 0.7, "emitter": {"type": "users_lamp"}},
        "point": {"type": "users_point"},
        "ball": sphere_lamp([-3, 3, 2], 0.4, 9.0),
        "sky": {"type": "users_sky"},
    }
    if "ball" in lamps:
        place, emitter = T().translate([0, 4, 1]).rotate([1, 0, 0], 90), {"type": "users_lamp", "varies": True}
        things["lamp"] = rectangle(place, emitter=emitter)
    assert compared(scene({"type": "diffuse"}, **{name: things[name] for name in lamps}), ours, reference)


@pytest.mark.slow
@pytest.mark.parametrize("ours", [TREE, PATHS])
def test_users_lamp_with_a_sampling_weight_of_0_is_not_sampled(variant_rgb, ours):
    """Mitsuba never calls its ``sample_direction``, so a user can switch the lamp off in ``eval`` alone."""

    class Switch(Lamp):
        def eval(self, si, active):
            return super().eval(si, active) if self.sampling_weight() > 0 else mi.Color3f(0)

    mi.register_emitter("users_switch", Switch)
    off = {"type": "users_switch", "sampling_weight": 0.0}
    lamps = {"lamp": {"type": "sphere", "center": [0, 4, 2], "emitter": off}, "on": sphere_lamp([3, 3, 2], 0.5, 9.0)}
    lit = scene({"type": "diffuse"}, **lamps)
    assert compared(lit, ours, FIRST if ours is TREE else WHOLE)


@pytest.mark.slow
@pytest.mark.parametrize("sky", [False, True])
def test_photons_of_a_users_lamp(variant_rgb, sky):
    """Beside the sky, the lamp has a method that lacks an argument."""

    class Wrong(Lamp):
        def eval_direction(self, it, ds):
            return mi.Color3f(1)

    mi.register_emitter("users_lamp", Wrong if sky else Lamp)
    mi.register_emitter("users_sky", Sky)
    lamp = {"type": "sphere", "center": [0, 4, 2], "radius": 0.7, "emitter": {"type": "users_lamp"}}
    lit = scene({"type": "dielectric"}, lamp=lamp, **({"sky": {"type": "users_sky"}} if sky else {}))
    assert compared(lit, {**PATHS, "caustics": True, "caustic_photons": 100000}, WHOLE)


class Depth(mi.llvm_ad_rgb.SamplingIntegrator):
    """The distance of the first surface, and a number of Python; as many of users, without ``to_string``."""

    def aov_names(self):
        return ["one"]

    def sample(self, scene, sampler, ray, medium, active):
        si = scene.ray_intersect(ray, active)
        return dr.select(si.is_valid(), si.t, 0.0), si.is_valid(), [1]


@pytest.mark.slow
def test_integrator_without_a_description(variant_rgb):
    mi.register_integrator("users_depth", Depth)
    mi.register_emitter("users_point", Point)
    room = scene({"type": "diffuse"}, point={"type": "users_point"})
    nested = {"type": "users_depth"}
    adaptive = {"type": "prosim_adaptive", "nested": nested, "samples": 4}
    assert compared(room, adaptive, nested)
    found = mitsuba_prosim.render({**room, "integrator": nested}, noise=0.05)
    assert "error" in found.verdict and "Depth[]" in str(mi.load_dict(adaptive))
    assert "point" in str(mitsuba_prosim.explain(mi.load_dict({**room, "integrator": TREE}), (8, 8)))


def test_users_render_that_is_not_called_is_warned_of(variant_rgb, logged):
    path = type(mi.load_dict({"type": "prb"}))

    class Bright(Depth):
        def render(self, *what, **how):
            return 2 * super().render(*what, **how)

    class Shifted(path):
        def sample_rays(self, *what):
            rays, *more = super().sample_rays(*what)
            rays.o.x += 1
            return rays, *more

    for name, integrator in (("depth", Depth), ("bright", Bright), ("path", path), ("shifted", Shifted)):
        mi.register_integrator(f"users_{name}", integrator)
        adaptive = {"type": "prosim_adaptive", "nested": {"type": f"users_{name}"}}
        mi.render(mi.load_dict({**scene({"type": "diffuse"}), "integrator": adaptive}), spp=1)
    said = "render() of Bright is not called", "sample_rays() of Shifted is not called"
    assert all(text in found for text, (_, found) in zip(said, logged, strict=True))

    # The images for the denoiser, and for ``prosim compare``, are those that the class returns.
    loaded, bright = mi.load_dict(scene({"type": "diffuse"})), mi.load_dict({"type": "users_bright"})
    steps = progressive(loaded, loaded.sensors()[0], bright, seed=1, spp=1)
    list(steps)
    assert np.array_equal(steps.half_images()[0], mi.render(loaded, integrator=bright, seed=1, spp=1))
    # Mitsuba's ``aov`` returns fewer channels than the film has, which may differ in the last bits.
    aov = mi.load_dict({"type": "aov", "aovs": "d:depth", "image": {"type": "path"}})
    list(progressive(loaded, loaded.sensors()[0], aov, spp=4))
    assert len(logged) == 2
    # Without the film's shape they cannot be stored.
    for image in (mi.TensorXf(np.ones((3, 3, 3), np.float32)), (1, 2)):
        bright.render = lambda *_, image=image, **__: image
        list(progressive(loaded, loaded.sensors()[0], bright))
        shape = "(3, 3, 3)" if hasattr(image, "shape") else "tuple"
        assert f"render() of Bright returns {shape}, but the film's image has" in logged[-1][1]


class Fisheye(mi.llvm_ad_rgb.Sensor):
    """A sensor whose method has no default for ``active``, which Mitsuba always passes."""

    def sample_ray_differential(self, time, wavelength_sample, position, lens, active):
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample, active)
        across = (position - 0.5) * 1.5
        angle = dr.norm(across)
        d = mi.Vector3f(across.x, across.y, 0) * (dr.sin(angle) / angle) - mi.Vector3f(0, 0, 1) * dr.cos(angle)
        return mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0, 0, 6), d, time, wavelengths)), weight


@pytest.mark.slow
@pytest.mark.parametrize("settings", [PATHS, {**PATHS, "caustics": True, "caustic_photons": 100000}])
def test_sensor_without_defaults(variant_rgb, settings):
    mi.register_sensor("users_fisheye", Fisheye)
    room = {**scene({"type": "dielectric"}), "sensor": {"type": "users_fisheye", "film": film(16)}}
    assert compared(room, settings, WHOLE)


@pytest.mark.parametrize("wrapper, flags", [(None, 0), ("twosided", 0), ("twosided", mi.BSDFFlags.DiffuseReflection)])
@pytest.mark.parametrize("ours", [TREE, PATHS, {"type": "prosim_adaptive", "nested": {"type": "path"}}])
def test_bsdf_without_flags_is_warned_of(variant_rgb, logged, ours, wrapper, flags):
    """Integrators cannot know what it scatters; Mitsuba's ``path`` loses a part of its light without a word."""

    class Flagless(two_lobes(typed=False, ideal=False)):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.m_flags = flags

    mi.register_bsdf("users_flagless", Flagless)
    bsdf = {"type": "users_flagless"}
    loaded = mi.load_dict({**scene({"type": wrapper, "b": bsdf} if wrapper else bsdf), "integrator": ours})
    mi.render(loaded, spp=1)
    assert ["surfaces of Flagless" in text and "m_flags" in text for _, text in logged] == [True]
