"""Faulty plugins fail the check, right plugins pass, and the command says what is wrong with its input."""

import mitsuba as mi
import mutants
import pytest
from click.testing import CliRunner
from mitsuba_prosim import check
from prosim_start.group import prosim

QUICK = [("bsdf", "pdf_too_large"), ("emitter", "point_ray_too_bright"), ("texture", "mean"), ("phase", "weight")]
STOCK = (
    "diffuse dielectric roughconductor plastic roughplastic principled null point spot constant directional area "
    "checkerboard hg rayleigh isotropic prosim_lambertian prosim_phong prosim_conductor prosim_dielectric "
    "prosim_composite prosim_area prosim_point prosim_stripes srgb"
)
#: Colours of both lobes: polarised variants once had those of one wavelength.
COLOURS = {
    "diffuse_reflectance": {"type": "rgb", "value": [0.15, 0.062, 0.379]},
    "specular_reflectance": {"type": "rgb", "value": [0.283, 0.304, 0.125]},
}


@pytest.fixture(autouse=True)
def registered(variant_rgb):
    mutants.register()


@pytest.mark.parametrize(
    "kind, name", [pytest.param(*one, marks=[] if one in QUICK else pytest.mark.slow) for one in mutants.NAMES]
)
def test_check_finds_fault(kind, name):
    report = check.check(f"mutant_{kind}_{name}", kind, modules=["mutants"])
    assert not report.ok
    with pytest.raises(check.WrongPluginError, match="fails"):
        report.raise_if_wrong()


@pytest.mark.parametrize(
    "kind, name", [pytest.param(*one, marks=[] if one in QUICK else pytest.mark.slow) for one in mutants.NAMES]
)
def test_check_accepts_unchanged_wrapper(kind, name):
    check.check(f"right_{kind}_{name}", kind, modules=["mutants"]).raise_if_wrong()


@pytest.mark.slow
@pytest.mark.parametrize("plugin", STOCK.split())
def test_check_accepts_plugin(plugin):
    check.check(plugin).raise_if_wrong()


@pytest.mark.slow
@pytest.mark.parametrize(
    "plugin", [{"type": "prosim_phong", "exponent": 73.3}, {"type": "prosim_composite", "int_ior": 1.9, "alpha": 0.45}]
)
def test_coloured_lobes_keep_their_colours_in_all_variants(plugin):
    check.check(plugin | COLOURS).raise_if_wrong()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["dffuse"], "Did you mean diffuse?"),
        (["diffuse", "-p", "x=1"], "diffuse has no parameter x"),
        (["missing.xml"], "no such file"),
        (["diffuse", "--import", "no_such_module"], "no_such_module"),
        (["<bsdf type='diffuse'/>", "-p", "x=1"], "into the XML"),
    ],
)
def test_command_refuses_input(arguments, message):
    result = CliRunner().invoke(prosim, ["check", "-m", mi.variant(), *arguments])
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output
