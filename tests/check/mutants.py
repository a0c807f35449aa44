"""Faulty plugins: each wraps one of Mitsuba's plugins, and changes what one or two of its methods return."""

import drjit as dr
import mitsuba as mi
import numpy as np

ROUGH = {"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"}
METAL = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
GLASS = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"}
IMAGE = {"type": "bitmap", "raw": True}


def spectral():
    return "spectral" in mi.variant()


#: Bits of BSDFFlags, which need no variant: FrontSide below, GlossyReflection 8, DeltaReflection 32.


def scaled(bs, factor=1.0, **fields):
    """A copy of a sample with its density scaled, and with other fields."""
    copy = mi.BSDFSample3f(bs)
    copy.pdf = bs.pdf * factor
    for name, value in fields.items():
        setattr(copy, name, value)
    return copy


# What a mutant does to (bs, weight) of sample(), to eval(), and to pdf(); ``flags`` replaces the flags.


def eval_(f):
    return {"eval": lambda v, si, wo, ctx: f(v, si, wo)}


def pdf(f):
    return {"pdf": lambda v, si, wo, ctx: f(v, wo, ctx)}


def weight(f):
    return {"sample": lambda bs, w, si, ctx: (bs, w * f(bs, si, ctx))}


def sample(f):
    return {"sample": lambda bs, w, si, ctx: (f(bs), w)}


def tilt(si):
    return 0.5 + 0.5 * dr.abs(si.wi.z)


BRUSHED, REFLECTS = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4}, 0x8000
BSDFS = {
    "pdf_too_large": (
        "diffuse",
        pdf(lambda v, wo, ctx: v * 1.1) | {"sample": lambda bs, w, si, ctx: (scaled(bs, 1.1), w / 1.1)},
    ),
    "weight_too_large": (METAL, weight(lambda bs, si, ctx: 1.05)),
    "mirror_above_one": ("conductor", weight(lambda bs, si, ctx: 1.2)),
    "not_reciprocal": ("diffuse", eval_(lambda v, si, wo: v * tilt(si)) | weight(lambda bs, si, ctx: tilt(si))),
    "eta_inverted": ("dielectric", sample(lambda bs: scaled(bs, eta=dr.rcp(bs.eta)))),
    "radiance_not_scaled": (
        "dielectric",
        weight(lambda bs, si, ctx: dr.square(bs.eta) if ctx.mode == mi.TransportMode.Radiance else 1),
    ),
    "delta_probability": ("plastic", sample(lambda bs: scaled(bs, dr.select((bs.sampled_type & 32) != 0, 0.8, 1)))),
    "transmission_as_reflection": (GLASS, sample(lambda bs: scaled(bs, sampled_type=mi.UInt32(8)))),
    "not_anisotropic": (BRUSHED, {"flags": REFLECTS | 0x8}),
    "flags_of_a_mirror": ("diffuse", {"flags": REFLECTS | 0x20}),
    "nan_at_grazing": ("diffuse", eval_(lambda v, si, wo: v / dr.select(wo.z < 0.01, 0.0, 1.0))),
    "negative": ("diffuse", eval_(lambda v, si, wo: v - 0.01)),
    "spectral_too_bright": ("diffuse", eval_(lambda v, si, wo: v * (1.2 if spectral() else 1))),
    "front_side_only": ("dielectric", {"flags": REFLECTS | 0x60}),
    "wrong_component": (ROUGH, sample(lambda bs: scaled(bs, sampled_component=mi.UInt32(0)))),
    "weight_of_component": ("dielectric", weight(lambda bs, si, ctx: 2 if ctx.component == 0 else 1)),
    "albedo_times_pi": ("diffuse", {"eval_diffuse_reflectance": lambda v: v * np.pi}),
    "derivative_too_small": ("diffuse", eval_(lambda v, si, wo: v * 0.8 + dr.detach(v) * 0.2)),
    "unpolarised_eval": (METAL, eval_(lambda v, si, wo: mi.depolarizer(v[0, 0]) if mi.is_polarized else v)),
    "one_component": (ROUGH, pdf(lambda v, wo, ctx: v * (1.3 if ctx.component == 1 else 1))),
}

EMITTERS = {
    "point_ray_too_bright": ("point", {"sample_ray": lambda ray, w: (ray, w * 1.1)}),
    "sky_turned": ("sunsky", {"sample_direction": lambda ds, w, it: (turned(ds), w)}),
    "constant_pdf": ("constant", {"pdf_direction": lambda v, it, ds: v * 1.2}),
    "constant_eval": ("constant", {"eval": lambda v, si: v * 0.9}),
    "constant_ray": ("constant", {"sample_ray": lambda ray, w: (mi.Ray3f(ray.o, -ray.d), w)}),
    "directional_weight": ("directional", {"sample_direction": lambda ds, w, it: (ds, w * 1.1)}),
    "ray_red": ("point", {"sample_ray": lambda ray, w: (ray, w * (ray.wavelengths / 520 if spectral() else 1))}),
    "point_inside_scene": ("directional", {"sample_direction": lambda ds, w, it: (near(ds), w)}),
    "spectral_point": ("point", {"sample_direction": lambda ds, w, it: (ds, w * (1.3 if spectral() else 1))}),
}


def near(ds):
    copy = mi.DirectionSample3f(ds)
    copy.dist, copy.p = ds.dist * 0.1, ds.p - ds.d * ds.dist * 0.9
    return copy


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
    "pdf": (
        {"type": "hg", "g": 0.5},
        {"eval_pdf": lambda v, p: (v, p * 1.1), "sample": lambda wo, w, p: (wo, w / 1.1, p * 1.1)},
    ),
    "backwards": ({"type": "hg", "g": 0.5}, {"sample": lambda wo, w, p: (-wo, w, p)}),
}


def nested(plugin):
    found = dict(plugin) if isinstance(plugin, dict) else {"type": plugin}
    if found["type"] == "bitmap":
        found["data"] = mi.TensorXf(np.random.default_rng(1).random((8, 8, 1), dtype=np.float32))
    if found["type"] == "twosided":
        found["nested"] = {"type": "diffuse"}
    return mi.load_dict(found)


OF_BSDFS = {"sample": (1, 0), "eval": (1, 2, 0), "pdf": (1, 2, 0), "eval_diffuse_reflectance": ()}
#: Kind -> the name of the base class, the methods that a mutant may change, each with the arguments that the change
#: gets, the methods that it only passes on, and the mutants.
KINDS = {
    "bsdf": ("BSDF", OF_BSDFS, "", BSDFS),
    "emitter": (
        "Emitter",
        {"sample_ray": (), "sample_direction": (0,), "pdf_direction": (0, 1), "eval_direction": (0, 1), "eval": (0,)},
        "sample_position pdf_position sample_wavelengths bbox set_scene is_environment",
        EMITTERS,
    ),
    "texture": (
        "Texture",
        {"eval": (0,), "eval_1": (0,), "eval_3": (0,)},
        "mean max is_spatially_varying resolution eval_1_grad sample_position pdf_position",
        TEXTURES,
    ),
    "phase": ("PhaseFunction", {}, "sample eval_pdf projected_area max_projected_area", PHASES),
}


def wrapper(kind, plugin, change):
    """A class whose methods are those of ``plugin``, with the results of some of them changed."""
    name, methods, others, _ = KINDS[kind]
    base = getattr(mi, name)

    class Mutant(base):
        def __init__(self, props):
            super().__init__(props)
            self.plugin = nested(plugin)
            if kind != "texture":
                self.m_flags = change.get("flags", self.plugin.flags())
            if kind == "bsdf":
                count = self.plugin.component_count()
                self.m_components = [change.get("flags", self.plugin.flags(i)) for i in range(count)]

        def traverse(self, callback):
            self.plugin.traverse(callback)

        def parameters_changed(self, keys=()):
            self.plugin.parameters_changed(keys)

    for name, seen in (methods | dict.fromkeys(others.split(), ())).items():

        def method(self, *args, name=name, seen=seen):
            found = getattr(self.plugin, name)(*args)
            results = found if isinstance(found, tuple) else (found,)
            return change[name](*results, *(args[i] for i in seen)) if name in change else found

        setattr(Mutant, name, method)
    if kind == "bsdf":
        Mutant.eval_pdf = lambda self, *args: (self.eval(*args), self.pdf(*args))
    return Mutant


NAMES = [(kind, name) for kind, (*_, table) in KINDS.items() for name in table]


def register():
    """Registers each mutant, and each wrapper without a change, in the active variant."""
    for kind, (*_, table) in KINDS.items():
        for name, (plugin, change) in table.items():
            for variant in {mi.variant(), "scalar_rgb"}:
                add = getattr(getattr(mi, variant), f"register_{kind}")
                add(f"mutant_{kind}_{name}", wrapper(kind, plugin, change))
                add(f"right_{kind}_{name}", wrapper(kind, plugin, {}))


if mi.variant():
    register()
