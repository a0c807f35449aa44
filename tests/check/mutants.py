"""Faulty plugins: each wraps one of Mitsuba's plugins, and changes what one or two of its methods return."""

import drjit as dr
import mitsuba as mi
import numpy as np

ROUGH = {"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"}
METAL = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
GLASS = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"}
IMAGE = {"type": "bitmap", "raw": True}
SPECTRAL = "spectral"


def spectral():
    return SPECTRAL in mi.variant()


def scaled(bs, factor=1.0, **fields):
    """A copy of a sample with its density scaled, and with other fields."""
    copy = mi.BSDFSample3f(bs)
    copy.pdf = bs.pdf * factor
    for name, value in fields.items():
        setattr(copy, name, value)
    return copy


# What a mutant does to (bs, weight) of sample(si, ctx), to eval(wo), and to pdf(wo); flags replaces m_flags.
BSDFS = {
    "pdf_too_large": (
        "diffuse",
        {"pdf": lambda v, si, wo, ctx: v * 1.1, "sample": lambda bs, w, si, ctx: (scaled(bs, 1.1), w / 1.1)},
    ),
    "pdf_without_cosine": ("diffuse", {"pdf": lambda v, si, wo, ctx: dr.select(v > 0, dr.inv_two_pi, 0)}),
    "pdf_of_one_sample": (ROUGH, {"sample": lambda bs, w, si, ctx: (scaled(bs, 1.2), w)}),
    "eval_without_cosine": ("diffuse", {"eval": lambda v, si, wo, ctx: v / dr.maximum(dr.abs(wo.z), 1e-3)}),
    "no_cosine_at_all": (
        "diffuse",
        {
            "eval": lambda v, si, wo, ctx: v / dr.maximum(dr.abs(wo.z), 0.1),
            "sample": lambda bs, w, si, ctx: (bs, w / dr.maximum(dr.abs(bs.wo.z), 0.1)),
        },
    ),
    "weight_too_large": (METAL, {"sample": lambda bs, w, si, ctx: (bs, w * 1.05)}),
    "albedo_above_one": (
        "diffuse",
        {"eval": lambda v, si, wo, ctx: v * 2.2, "sample": lambda bs, w, si, ctx: (bs, w * 2.2)},
    ),
    "mirror_above_one": ("conductor", {"sample": lambda bs, w, si, ctx: (bs, w * 1.2)}),
    "light_below_horizon": ("diffuse", {"eval": lambda v, si, wo, ctx: v + dr.select(wo.z < 0, 0.05, 0)}),
    "not_reciprocal": (
        "diffuse",
        {
            "eval": lambda v, si, wo, ctx: v * (0.5 + 0.5 * dr.abs(si.wi.z)),
            "sample": lambda bs, w, si, ctx: (bs, w * (0.5 + 0.5 * dr.abs(si.wi.z))),
        },
    ),
    "eta_inverted": ("dielectric", {"sample": lambda bs, w, si, ctx: (scaled(bs, eta=dr.rcp(bs.eta)), w)}),
    "rough_eta_inverted": (GLASS, {"sample": lambda bs, w, si, ctx: (scaled(bs, eta=dr.rcp(bs.eta)), w)}),
    "radiance_not_scaled": (
        "dielectric",
        {
            "sample": lambda bs, w, si, ctx: (
                bs,
                w * (dr.square(bs.eta) if ctx.mode == mi.TransportMode.Radiance else 1),
            )
        },
    ),
    "glossy_lobe_lost": (ROUGH, {"eval": lambda v, si, wo, ctx: dr.minimum(v, 0.2)}),
    "delta_probability": (
        "plastic",
        {"sample": lambda bs, w, si, ctx: (scaled(bs, dr.select((bs.sampled_type & 32) != 0, 0.8, 1)), w)},
    ),
    "transmission_as_reflection": (
        GLASS,
        {"sample": lambda bs, w, si, ctx: (scaled(bs, sampled_type=mi.UInt32(8)), w)},
    ),
    "not_anisotropic": (
        {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4},
        {"flags": int(mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide)},
    ),
    "flags_of_a_mirror": ("diffuse", {"flags": int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.FrontSide)}),
    "nan_at_grazing": ("diffuse", {"eval": lambda v, si, wo, ctx: v / dr.select(wo.z < 0.01, 0.0, 1.0)}),
    "negative": ("diffuse", {"eval": lambda v, si, wo, ctx: v - 0.01}),
    "turned_half": (
        "twosided",
        {"sample": lambda bs, w, si, ctx: (scaled(bs, wo=mi.Vector3f(bs.wo.x, bs.wo.y, dr.abs(bs.wo.z))), w)},
    ),
    "spectral_too_bright": ("diffuse", {"eval": lambda v, si, wo, ctx: v * (1.2 if spectral() else 1)}),
    "one_component": (
        {"type": "roughplastic", "alpha": 0.3},
        {"pdf": lambda v, si, wo, ctx: v * (1.3 if ctx.component == 1 else 1)},
    ),
}

EMITTERS = {
    "point_squared": ("point", {"sample_direction": lambda ds, w, it: (ds, w * ds.dist)}),
    "point_ray_too_bright": ("point", {"sample_ray": lambda ray, w: (ray, w * 1.1)}),
    "sky_turned": (
        {"type": "sunsky"},
        {"eval_direction": lambda v, it, ds: v, "sample_direction": lambda ds, w, it: (turned(ds), w)},
    ),
    "constant_pdf": ("constant", {"pdf_direction": lambda v, it, ds: v * 1.2}),
    "constant_eval": ("constant", {"eval": lambda v, si: v * 0.9}),
    "spot_flux": ("spot", {"sample_ray": lambda ray, w: (ray, w * 0.9)}),
    "constant_ray": ("constant", {"sample_ray": lambda ray, w: (mi.Ray3f(ray.o, -ray.d), w)}),
    "directional_weight": ("directional", {"sample_direction": lambda ds, w, it: (ds, w * 1.1)}),
    "spectral_point": ("point", {"sample_direction": lambda ds, w, it: (ds, w * (1.3 if spectral() else 1))}),
}


def turned(ds):
    copy = mi.DirectionSample3f(ds)
    copy.d = mi.Vector3f(ds.d.y, ds.d.x, ds.d.z)
    return copy


TEXTURES = {
    "mean": (IMAGE, {"mean": lambda v: v * 1.1}),
    "eval_1": (IMAGE, {"eval_1": lambda v, si: v * 1.1}),
    "not_varying": (IMAGE, {"is_spatially_varying": lambda v: False}),
    "gradient": (IMAGE, {"eval_1_grad": lambda v: v * 0.5}),
}

PHASES = {
    "not_normalised": ({"type": "hg", "g": 0.5}, {"eval_pdf": lambda v, p: (v * 1.1, p)}),
    "pdf": (
        {"type": "hg", "g": 0.5},
        {"eval_pdf": lambda v, p: (v, p * 1.1), "sample": lambda wo, w, p: (wo, w / 1.1, p * 1.1)},
    ),
    "backwards": ({"type": "hg", "g": 0.5}, {"sample": lambda wo, w, p: (-wo, w, p)}),
    "weight": ("rayleigh", {"sample": lambda wo, w, p: (wo, w * 1.1, p)}),
}


def nested(plugin):
    found = dict(plugin) if isinstance(plugin, dict) else {"type": plugin}
    if found["type"] == "bitmap":
        found["data"] = mi.TensorXf(np.random.default_rng(1).random((8, 8, 1), dtype=np.float32))
    if found["type"] == "twosided":
        found["nested"] = {"type": "diffuse"}
    return mi.load_dict(found)


def wrapper(base, plugin, change, methods):
    """A class whose methods are those of ``plugin``, with the results of some of them changed."""

    class Mutant(base):
        def __init__(self, props):
            super().__init__(props)
            self.plugin = nested(plugin)
            if base in (mi.BSDF, mi.Emitter, mi.PhaseFunction):
                self.m_flags = change.get("flags", self.plugin.flags())
            if base is mi.BSDF:
                count = self.plugin.component_count()
                self.m_components = [change.get("flags", self.plugin.flags(i)) for i in range(count)]

        def traverse(self, callback):
            self.plugin.traverse(callback)

        def parameters_changed(self, keys=()):
            self.plugin.parameters_changed(keys)

    for name, seen in methods.items():

        def method(self, *args, name=name, seen=seen):
            found = getattr(self.plugin, name)(*args)
            results = found if isinstance(found, tuple) else (found,)
            return change[name](*results, *(args[i] for i in seen)) if name in change else found

        setattr(Mutant, name, method)
    return Mutant


def bsdf(plugin, change):
    cls = wrapper(
        mi.BSDF, plugin, change, {"sample": (1, 0), "eval": (1, 2, 0), "pdf": (1, 2, 0), "eval_diffuse_reflectance": ()}
    )
    cls.eval_pdf = lambda self, *args: (self.eval(*args), self.pdf(*args))
    return cls


def emitter(plugin, change):
    methods = {
        "sample_ray": (),
        "sample_direction": (0,),
        "pdf_direction": (0, 1),
        "eval_direction": (0, 1),
        "eval": (0,),
    }
    others = ("sample_position", "pdf_position", "sample_wavelengths", "bbox", "set_scene", "is_environment")
    return wrapper(mi.Emitter, plugin, change, methods | dict.fromkeys(others, ()))


def texture(plugin, change):
    methods = dict.fromkeys(("eval", "eval_1", "eval_3"), (0,))
    others = ("mean", "max", "is_spatially_varying", "resolution", "eval_1_grad", "sample_position", "pdf_position")
    return wrapper(mi.Texture, plugin, change, methods | dict.fromkeys(others, ()))


def phase(plugin, change):
    return wrapper(
        mi.PhaseFunction,
        plugin,
        change,
        dict.fromkeys(("sample", "eval_pdf", "projected_area", "max_projected_area"), ()),
    )


KINDS = {
    "bsdf": (bsdf, BSDFS),
    "emitter": (emitter, EMITTERS),
    "texture": (texture, TEXTURES),
    "phase": (phase, PHASES),
}
NAMES = [(kind, name) for kind, (_, table) in KINDS.items() for name in table]


def register():
    """Registers each mutant, and each wrapper without a change, in the active variant."""
    for kind, (make, table) in KINDS.items():
        for name, (plugin, change) in table.items():
            for variant in {mi.variant(), "scalar_rgb"}:
                add = getattr(getattr(mi, variant), f"register_{kind}")
                add(f"mutant_{kind}_{name}", make(plugin, change))
                add(f"right_{kind}_{name}", make(plugin, {}))


if mi.variant():
    register()
