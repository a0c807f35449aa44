"""Faulty plugins fail the check, right plugins pass, and the command says what is wrong with its input."""

from functools import partial

import drjit as dr
import mitsuba as mi
import mutants
import numpy as np
import pytest
from click.testing import CliRunner
from mitsuba_prosim import check
from mitsuba_prosim.check.kinds import images
from mitsuba_prosim.check.report import FAILS, Report
from mitsuba_prosim.check.subject import Subject, import_module
from prosim_start.group import prosim

QUICK = [("bsdf", "weight_too_large")]
STOCK = (
    "diffuse dielectric roughconductor plastic roughplastic principled null point spot constant directional area "
    "checkerboard hg rayleigh isotropic sphere cylinder multijitter stratified gaussian hdrfilm homogeneous "
    "prosim_lambertian prosim_composite prosim_area prosim_point prosim_product prosim nrook owen srgb"
)
LITERAL, SPOT = {"normalized": False}, {"distribution": "spot", "exponent": 6.0, "angle": 60.0}
GROOVES = {"multiple_scattering": True}
GAUSSIAN = {"alpha": 0.3, "distribution": "gaussian", "fresnel": "thesis", "eta": 1.5, "k": 2.0}
#: Plugins with parameters.
SETS = {
    "prosim_conductor": [{}, {"exponent": 20.0, **GROOVES}, {"exponent": 3.0}, GAUSSIAN],
    "prosim_dielectric": [{}, {"alpha": 0.3}, {"exponent": 30.0, "int_ior": 1.43, "int_abbe": 2.8}],
    "prosim_composite": [{"alpha": 1.0, "distribution": "gaussian", **GROOVES}],
    "prosim_phong": [{"exponent": 0.0}, {"exponent": 5.0, **LITERAL}],
    "prosim_area": [SPOT, {"distribution": "cone", "angle": 25.0}],
    "prosim_point": [SPOT, {"distribution": "cone", "angle": 25.0}],
    "thinlens": [{"aperture_radius": 0.1}],
    "prosim_stripes": [{"smoothing": 0.1}],
    "prosim_brick": [{"smoothing": 0.1}, {"solid": True}],
    "prosim_fractal": [{}, {"smoothing": 0.1, "octaves": 3}],
}
#: Colours of both lobes: polarised variants once had those of one wavelength.
COLOURS = {
    "diffuse_reflectance": {"type": "rgb", "value": [0.15, 0.062, 0.379]},
    "specular_reflectance": {"type": "rgb", "value": [0.283, 0.304, 0.125]},
}
SETS["prosim_phong"].append({"exponent": 73.3, **COLOURS})
SETS["prosim_composite"].append({"int_ior": 1.9, "alpha": 0.45, **COLOURS})
OURS = [{"type": name, **parameters} for name, sets in SETS.items() for parameters in sets]


@pytest.fixture(autouse=True)
def registered(variant_rgb):
    mutants.register()


class Found(BaseException):
    """A test has failed, and those that follow are left out."""


@pytest.fixture
def until_it_fails(monkeypatch):
    def add(report, *values, add=Report.add, **more):
        add(report, *values, **more)
        # A probability that fails with any number of tests.
        if (last := report.results[-1]).verdict == FAILS or not (last.p_value is None or last.p_value >= 1e-9):
            raise Found

    monkeypatch.setattr(Report, "add", add)


@pytest.mark.parametrize(
    "kind, name", [pytest.param(*one, marks=[] if one in QUICK else pytest.mark.slow) for one in mutants.NAMES]
)
def test_check_finds_fault(until_it_fails, kind, name):
    with pytest.raises(Found):
        check.check(f"mutant_{kind}_{name}", modules=["mutants"])


@pytest.mark.slow
def test_report_of_a_fault_raises():
    report = check.check("mutant_texture_mean", modules=["mutants"])
    assert not report.ok
    with pytest.raises(check.WrongPluginError, match="fails"):
        report.raise_if_wrong()


@pytest.mark.slow
@pytest.mark.parametrize("kind", mutants.KINDS)
def test_check_accepts_wrapper_without_a_change(kind):
    name, *_ = mutants.KINDS[kind][-1]
    check.check(f"right_{kind}_{name}", modules=["mutants"]).raise_if_wrong()


@pytest.mark.slow
def test_fault_of_a_users_wrapper_is_not_one_of_mitsuba():
    """``principled`` may have the same fault, but has it not with these parameters."""

    class Wrapper(mutants.wrapper("bsdf", *mutants.BSDFS["not_reciprocal"])):
        def __init__(self, props):
            super().__init__(props)
            self.inner = props["inner"]

    mi.register_bsdf("wrapper", Wrapper)
    assert not check.check({"type": "wrapper", "inner": {"type": "principled"}}).ok


@pytest.mark.slow
def test_users_bsdf_that_ignores_types_and_masks_is_right():
    """Images are right: Mitsuba's integrators ask for all types, Dr.Jit masks results, and arguments are copies. An
    exposed number of Python, which Mitsuba cannot set, matters to nobody else.
    """

    def value(_, si, wo):
        return dr.select((si.wi.z > 0) & (wo.z > 0), mi.Spectrum(0.5 * dr.inv_pi) * wo.z, 0)

    def turned(density, wo, _):
        wo *= -1
        return density

    class Careless(mutants.wrapper("bsdf", "diffuse", mutants.eval_(value) | mutants.pdf(turned))):
        def __init__(self, props):
            super().__init__(props)
            self.gloss = props.get("gloss", 0.5)

        def traverse(self, callback):
            callback.put("gloss", self.gloss, mi.ParamFlags.NonDifferentiable)

    mi.register_bsdf("careless", Careless)
    report = check.check("careless")
    assert report.ok and "note" in {result.verdict for result in report.results}


@pytest.mark.slow
@pytest.mark.parametrize("plugin", STOCK.split() + OURS, ids=str)
def test_check_accepts_plugin(plugin):
    check.check(plugin).raise_if_wrong()


@pytest.mark.slow
@pytest.mark.parametrize("colours", ["mono", "spectral"])
def test_check_in_variants_without_exact_colours_accepts_those_of_others(colours):
    mi.set_variant(mi.variant().replace("rgb", colours))
    check.check({"type": "conductor", "material": "Cu"}).raise_if_wrong()


@pytest.mark.slow
def test_check_accepts_denoised_images(monkeypatch):
    first = list(images.scenes())[:2]
    monkeypatch.setattr(images, "scenes", lambda: first)
    check.check("prosim_denoised").raise_if_wrong()


def tilted(ps):
    ps.n = dr.normalize(ps.n + mi.Normal3f(0.3, 0.2, 0.1))
    return ps


def lifted(ps):
    ps.p += ps.n * 0.02
    return ps


def parallel(ray, weight):
    ray.d_x = ray.d
    return ray, weight


def upside_down(develop, **raw):
    return mi.TensorXf(develop(**raw).numpy()[::-1])


SMALL, CAMERA = {"type": "hdrfilm", "width": 40, "height": 30}, {"type": "perspective"}
#: Class of plugins, plugin, method, and what is wrong with its results.
FAULTS = [
    ("Shape", "cylinder", "surface_area", lambda area, *_: area() * 1.1),
    ("Sensor", CAMERA, "sample_ray_differential", lambda sample, *u: parallel(*sample(*u))),
    ("Film", SMALL, "develop", upside_down),
    ("Shape", "cylinder", "pdf_position", lambda pdf, ps: pdf(ps) * 1.1),
    ("Shape", "cylinder", "pdf_direction", lambda pdf, *at: pdf(*at) * 1.1),
    ("Shape", "cylinder", "sample_position", lambda sample, time, u: sample(time, mi.Point2f(u.x * u.x, u.y))),
    ("Shape", "cylinder", "sample_position", lambda sample, *u: tilted(sample(*u))),
    ("Shape", "cylinder", "sample_position", lambda sample, *u: lifted(sample(*u))),
    ("Sensor", CAMERA, "sample_ray", lambda _, *u: mi.load_dict(CAMERA).sample_ray(*u)),
]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_check_finds_fault_of_method(until_it_fails, monkeypatch, fault):
    kind, plugin, method, change = fault
    right = getattr(getattr(mi, kind), method)
    monkeypatch.setattr(f"mitsuba.{kind}.{method}", lambda one, *u, **raw: change(partial(right, one), *u, **raw))
    with pytest.raises(Found):
        check.check(plugin)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [{"max_depth": 4}, {"rr_depth": 1, "max_depth": 5}])
def test_integrator_that_ignores_its_depth_fails(monkeypatch, limits):
    """In the closed rooms, which are the last scenes."""
    rooms = list(images.scenes())[-2:]
    monkeypatch.setattr(images, "scenes", lambda: rooms)

    class Fixed(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(props)
            assert all(props[key] for key in props)  # Mitsuba refuses properties that nobody reads
            self.nested = mi.load_dict({"type": "volpath", **limits})

        def sample(self, *args):
            return self.nested.sample(*args)

    mi.register_integrator("fixed", Fixed)
    assert not check.check({"type": "fixed", "max_depth": 12}).ok


@pytest.mark.slow
def test_solids_of_a_scene_in_the_language_are_right(variant_rgb, tmp_path):
    scene = tmp_path / "ball.scn"
    scene.write_text("LIGHTS POINT position 0 9 9 CSG-TREE SPHERE 0 SURFACE 0 TRANSFORM 0 END")
    (shape,) = [node for node in Subject(scene).nodes() if Subject(scene, node).name == "ply"]
    assert check.check(scene, node=shape).ok


def test_files_and_groups_of_a_scene(variant_rgb, tmp_path):
    """Files lie in the folders of its elements <path>; groups and instances are not tested, but what is in them."""
    scene, folder = tmp_path / "scene.xml", tmp_path / "pictures"
    folder.mkdir()
    mi.Bitmap(np.full((2, 2, 3), 128, np.uint8)).write(str(folder / "a.png"))
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/></texture>'
    ball = f'<shape type="sphere"><bsdf type="diffuse">{texture}</bsdf></shape>'
    group = f'<shape type="shapegroup" id="g">{ball}</shape><shape type="instance"><ref id="g"/></shape>'
    scene.write_text(f'<scene version="3.0.0"><path value="pictures"/>{group}</scene>')
    nodes = {Subject(scene, node).name: node for node in Subject(scene).nodes()}
    assert nodes.keys() == {"shapegroup", "instance", "sphere", "diffuse", "bitmap", "path"}  # the default integrator
    Subject(scene, nodes["bitmap"]).load()
    for name in "shapegroup", "instance":
        assert {result.verdict for result in check.check(scene, node=nodes[name]).results} == {"not tested"}


def test_scalar_variants_are_refused(variant_scalar):
    with pytest.raises(RuntimeError, match="scalar_rgb takes one input at a time"):
        check.check("diffuse")


def test_module_cannot_change_the_variant(tmp_path):
    (tmp_path / "own_variant.py").write_text("import mitsuba as mi\nmi.set_variant('scalar_spectral')")
    before = mi.variant()
    import_module(str(tmp_path / "own_variant.py"))
    assert mi.variant() == before


@pytest.mark.slow
def test_module_of_one_variant_is_not_tested_in_others(tmp_path):
    lines = f"import mitsuba as mi, mutants\nassert mi.variant() == {mi.variant()!r}"
    (tmp_path / "one_variant.py").write_text(lines)
    report = check.check("right_bsdf_pdf_too_large", modules=[str(tmp_path / "one_variant.py")])
    assert "not tested" in {result.verdict for result in report.results if result.test == "variants agree"}
    report.raise_if_wrong()


@pytest.mark.slow
def test_known_fault_of_nested_bsdf_is_a_note():
    report = check.check({"type": "twosided", "nested": {"type": "principled", "metallic": 0.5}})
    assert "note" in {result.verdict for result in report.results}
    report.raise_if_wrong()


def test_check_passes_active_to_methods(monkeypatch):
    class Half(mi.Texture):
        """Its methods need the argument ``active``, which Mitsuba always passes."""

        def eval(self, si, active):
            return mi.UnpolarizedSpectrum(0.5) & active

        def eval_1(self, si, active):
            return mi.Float(0.5) & active

    mi.register_texture("half", Half)
    monkeypatch.setattr(mi, "variants", list)  # those that it is compared in
    verdicts = {result.test: result.verdict for result in check.check("half").results}
    assert verdicts["eval_1() = eval()"] == "ok"


@pytest.mark.parametrize("plugin", ["aov", "prosim_features"])
def test_check_of_image_without_light_tests_no_light(plugin):
    report = check.check(plugin)
    assert [result.verdict for result in report.results] == ["not tested"]
    assert report.table().startswith(f"integrator {plugin}: not tested\n")


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["dffuse"], "Did you mean diffuse?"),
        (["diffuse", "-p", "x=1"], "diffuse has no parameter x"),
        *[(["diffuse", "-p", f"reflectance={text}"], "got string") for text in ("null", "[1]", "a,b,c")],
        (["bitmap"], "this bitmap has no filename, which it needs"),
        (["missing.xml"], "no such file, or a file with -p"),
        (["diffuse", "--import", "no_such_module"], "no_such_module"),
        (["diffuse", "--import", "broken.py"], "register_nothing"),
    ],
)
def test_command_refuses_input(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.py").write_text("import mitsuba as mi\nmi.register_nothing('x')")
    result = CliRunner().invoke(prosim, ["check", "-m", mi.variant(), *arguments])
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output
