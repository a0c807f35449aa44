"""Each plugin says which of its parameters is wrong, and what is allowed."""

import math

import mitsuba as mi
import pytest
from mitsuba_prosim.engine.policies import POLICIES
from scenes import T, camera, film, load_scene, rgb

RGB = {"type": "rgb", "value": [0.2, 0.4, 0.6]}
SUM = "diffuse_reflectance + specular_reflectance"
CONE = {"distribution": "cone", "angle": 25.0, "direction": [-1, -2, 0]}
SPECTRUM = {"type": "spectrum", "value": [(400, 1.0), (700, -1.0)]}
PATH = {"a": {"type": "path"}}
FLAGS = [(f"prosim_{k}", "multiple_scattering", 1.0) for k in ("conductor", "composite", "dielectric")]
FLAGS += [("prosim_area", "unattenuated", "no"), ("prosim_brick", "solid", "false"), ("prosim", "shadows", 0)]
FLAGS += [("prosim", "caustics", 2000)]
BRICK = {"brick_width": 0.0, "brick_height": -1.0, "mortar_width": -0.1, "smoothing": -1.0}
STRIPES = {"frequency": 0.0, "duty": 1.5, "axis": [0, 0, 1]}
FRACTAL = {"scale": 0.0, "octaves": 17, "gain": -1.0, "lacunarity": 0.0, "seed": -1}

BEAMS = [
    ("distribution", {"distribution": "laser"}),
    ("direction", {**CONE, "direction": [0, 0, 0]}),
    ("direction", {"direction": [0, 0, 1]}),
    ("angle", {"distribution": "cone"}),
    ("angle", {**CONE, "angle": 181.0}),
    ("angle", {"angle": 20.0}),
    ("exponent", {"distribution": "spot"}),
    ("exponent", {**CONE, "exponent": 3.0}),
    ("to_world", {"to_world": T}),
]
#: Plugins, the parameter that the error names, and all parameters.
NAMED = [
    *((f"prosim_{source}", *wrong) for source in ("area", "point") for wrong in BEAMS),
    *(("prosim_area", "radiance", {"radiance": v}) for v in (-1.0, math.nan, math.inf, rgb(1, -0.2, 0.3), SPECTRUM)),
    ("prosim_point", "intensity", {"intensity": {"type": "checkerboard"}}),
    ("prosim_point", "position", {"position": [0, math.nan, 0]}),
    ("prosim_point", "intensity", {"intensity": -1.0}),
    *(("prosim_brick", name, {name: value}) for name, value in BRICK.items()),
    *(("prosim_stripes", name, {name: value}) for name, value in STRIPES.items()),
    *(("prosim_fractal", name, {name: value}) for name, value in FRACTAL.items()),
    *(("prosim_fractal", "octaves", {"octaves": value}) for value in (0, -1, math.nan, math.inf, True, "three")),
    *(("prosim_fractal", "scale", {"scale": value}) for value in (math.nan, math.inf, True, "three")),
]
#: Plugins, parameters, and words of the error.
WRONG = [
    *((plugin, parameters, f'parameter "{name}" is |; allowed: ') for plugin, name, parameters in NAMED),
    ("prosim_conductor", {"alpha": -0.1}, "alpha|-0.1|a number between 0 and 1000"),
    ("prosim_conductor", {"distribution": "ggx"}, "distribution|ggx|beckmann, gaussian, phong"),
    ("prosim_conductor", {"exponent": 10.0, "alpha": 0.1}, 'alpha|"exponent"'),
    ("prosim_conductor", {"material": "Unobtainium"}, "material|Unobtainium|Cu_palik"),
    ("prosim_conductor", {"material": "Cu", "k": 1.0}, '"k"|material|Cu'),
    ("prosim_conductor", {"fresnel": "schlick"}, "fresnel|schlick|exact or thesis"),
    *((plugin, {name: value}, f'"{name}" is |; allowed: true or false') for plugin, name, value in FLAGS),
    ("prosim_dielectric", {"int_ior": "glas"}, "int_ior|glas|a number > 0, or |vacuum|bk7"),
    ("prosim_dielectric", {"int_ior": RGB}, "int_ior|0.4|> 0"),
    ("prosim_dielectric", {"alpha": "rough"}, "alpha|rough|a number, a colour or a texture"),
    ("prosim_dielectric", {"int_ior": 1.5, "ext_ior": 1.5, "alpha": 0.1}, "int_ior|1.5|ext_ior"),
    ("prosim_dielectric", {"int_material": "glas"}, "int_material|glas|bk7"),
    ("prosim_dielectric", {"int_material": "bk7", "int_ior": 1.5}, "int_material|int_ior"),
    ("prosim_dielectric", {"int_material": "bk7", "int_abbe": 50.0}, "int_abbe|int_material"),
    ("prosim_dielectric", {"int_abbe": 50.0}, "int_abbe|int_ior"),
    ("prosim_dielectric", {"int_ior": 1.5, "int_abbe": 0.0}, "int_abbe|>= 1"),
    *[
        ("prosim_dielectric", {"int_material": text}, "int_material|bk7, f2|B1, C1")
        for text in ("1, x", "1, .3", "1, 2, 3")
    ],
    ("prosim_dielectric", {"int_ior": 0.5, "int_abbe": 1.0}, "int_abbe|index is > 0 from 360"),
    ("prosim_lambertian", {"reflectance": RGB | {"value": [0.1, 1.2, 0.3]}}, "reflectance|1.2|0 and 1"),
    ("prosim_lambertian", {"reflectance": {"type": "uniform", "value": 1.2}}, "reflectance|up to 1.2|0 and 1"),
    ("prosim_conductor", {"specular_reflectance": {"type": "d65", "scale": 1.2}}, "specular_reflectance|0 and 1"),
    ("prosim_composite", {"diffuse_reflectance": 0.7, "specular_reflectance": 0.4}, f"{SUM}|1.1|<= 1"),
    ("prosim_composite", {"diffuse_reflectance": 0.7, "specular_reflectance": RGB}, f"{SUM}|1.3|<= 1"),
    *(("prosim_composite", {"int_ior": n}, 'parameter "int_ior" is |; allowed: |> 0') for n in (-1.0, 0.0, "wine")),
    ("prosim_composite", {"specular_reflectance": 0.9}, f"{SUM}|1.4|diffuse_reflectance is 0.5 if not given"),
    ("prosim_phong", {"distribution": "gaussian"}, "distribution|gaussian|phong"),
    ("prosim_fractal", {"octaves": 2.7}, 'parameter "octaves" is 2.7; allowed: a whole number >= 1 and <= 16.'),
    ("prosim_fractal", {"scale": 0.0}, 'parameter "scale" is 0.0; allowed: a number > 0.'),
    ("prosim_point", {"id": "lamp", "distribution": "cone"}, '"lamp" (prosim_point): parameter "angle" is missing; '),
    ("prosim", {"adaptive": 4}, 'parameter "adaptive" is 4; allowed: one of '),
    ("prosim", {"adaptive": "always"}, 'parameter "adaptive" is |always|; allowed: one of ' + ", ".join(POLICIES)),
    *(("prosim", {name: 0}, f'parameter "{name}" is 0; allowed: a whole number >= 1') for name in ("samples", "band")),
    ("prosim", {"max_level": -1}, 'parameter "max_level" is -1; allowed: 0 to 24'),
    ("prosim", {"channels": "rgx"}, 'parameter "channels"'),
    ("prosim", {"aovs": "sample"}, 'parameter "aovs" is |sample|; allowed: samples, error'),
    ("prosim", {"layers": "lamps"}, "none or lights"),
    ("prosim", {"layers": "lights", "caustics": True}, "caustics"),
    ("prosim_adaptive", {}, "\"integrator\" is 'nothing'; allowed: one integrator that takes samples"),
    ("prosim_adaptive", PATH | {"b": {"type": "direct"}}, "is 'PathIntegrator, DirectIntegrator'; allowed: one"),
    ("prosim_adaptive", {"a": {"type": "ptracer"}}, "ParticleTracerIntegrator|takes samples from a sensor"),
    ("prosim", {"adaptive": "variance", "noise": 0.1}, "because noise needs many samples"),
    ("prosim_adaptive", PATH | {"adaptive": "thesis", "noise": 0.1}, "because noise needs many samples"),
    ("prosim_adaptive", PATH | {"noise": -1.0}, '"noise" is -1.0'),
    ("prosim_adaptive", PATH | {"max_level": 2}, "max_level"),
    ("prosim_adaptive", PATH | {"b": {"type": "diffuse"}}, "PathIntegrator, SmoothDiffuse"),
    ("prosim_denoised", {"a": {"type": "ptracer"}}, "takes samples from a sensor"),
    ("prosim_denoised", PATH | {"b": {"type": "path"}}, "takes samples from a sensor"),
    ("prosim_window", {"left": 2.0}, "left"),
    ("prosim", {"aovs": 3}, 'parameter "aovs" is 3; allowed: a text'),
    ("prosim", {"channels": True}, 'parameter "channels" is True; allowed: a text'),
    ("prosim", {"adaptive": [1, 2, 3]}, 'parameter "adaptive" is |allowed: one of'),
    ("prosim_conductor", {"material": [1, 2, 3]}, 'parameter "material" is |allowed: a text'),
    ("prosim_conductor", {"alpha": 2000.0}, 'parameter "alpha" is 2000.0; allowed: a number between 0 and 1000'),
    ("prosim_point", {"position": 2.0}, 'parameter "position" is 2.0; allowed: finite coordinates'),
    ("prosim_point", {"position": "1, 2, 3"}, "parameter \"position\" is '1, 2, 3'; allowed: finite coordinates"),
    ("prosim_point", CONE | {"direction": True}, 'parameter "direction" is True; allowed: a vector of finite length'),
    ("nrook", {"jitter": "none"}, 'parameter "jitter" is |allowed: multi or uniform'),
]


@pytest.mark.parametrize("plugin, parameters, words", WRONG)
def test_wrong_parameters_are_named(variant_rgb, plugin, parameters, words):
    parameters = {name: value() if value is T else value for name, value in parameters.items()}
    with pytest.raises((RuntimeError, ValueError)) as error:
        mi.load_dict({"type": plugin, **parameters})
    said = str(error.value)
    for word in (plugin, *words.split("|")):
        assert word in said


def test_a_whole_number_may_be_written_as_a_float(variant_rgb):
    assert type(mi.load_dict({"type": "prosim_fractal", "octaves": 3.0}).octaves) is int


@pytest.mark.parametrize("parameters", [{"layers": "lights"}, {"caustics": True}])
def test_what_scalar_variants_lack_is_refused(variant_scalar, parameters):
    with pytest.raises(RuntimeError, match=f'parameter "{min(parameters)}" is .*; allowed: .*scalar_rgb'):
        mi.load_dict({"type": "prosim", **parameters})


@pytest.mark.parametrize("integrator", [{"type": "prosim"}, {"type": "prosim_adaptive", **PATH}])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_statistics_of_a_pixel_are_refused_where_rays_are_single(variant, integrator):
    """In scalar variants, and within another integrator; they had been 0."""
    mi.set_variant(variant)
    integrator = integrator | {"aovs": "samples,error"}
    scene = load_scene(sensor=camera([0, 0, 4], [0, 0, 0], film(1)), ball={"type": "sphere"}, sky={"type": "constant"})
    if variant != "scalar_rgb":
        integrator = {"type": "aov", "aovs": "d:depth", "nested": integrator}
    with pytest.raises(RuntimeError) as error:
        mi.render(scene, integrator=mi.load_dict(integrator), spp=1)
    assert "aovs samples, error are for its own render() alone" in f"{error.value}{error.value.__cause__}"
