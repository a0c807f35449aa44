"""From samples to an image: counts, seeds, sensors, filters, extreme values (section 5.3.2), the order of lamps."""

import traceback

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import blocks, renderings, same_expectation
from mitsuba_prosim.alone import alone
from mitsuba_prosim.scene.scene_file import SceneFile
from scenes import T, camera, film, load_scene, loaded, penumbra, rectangle, slow


@pytest.mark.parametrize("spp, least, most", [(4, 0, 0.9), (5, 0.9, 1.1)])
def test_neighbours_share_a_sequence_if_there_are_few_samples(variant_rgb, spp, least, most):
    """The variance of the means of 2 x 2 pixels, over that of independent pixels; five samples share nothing."""
    images = renderings(penumbra(size=96, type="prosim", adaptive="none"), 12, spp=spp)
    assert least < 4 * blocks(images, 2).var(0).mean() / images.var(0).mean() < most


@pytest.mark.slow
def test_filter_within_a_pixel_is_that_of_mitsuba(variant_rgb):
    scene, ours = penumbra(), {"type": "prosim", "adaptive": "none"}
    box = renderings(scene, 1, spp=25, **ours)
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian", "stddev": 0.1}
    reference, images = renderings(scene, 20, spp=64, type="direct"), renderings(scene, 20, spp=25, **ours)
    assert same_expectation(images, reference) and not np.array_equal(box[0], images[0])


@pytest.mark.parametrize("radiance", [1e20, 1e25, 1e30])
def test_the_error_of_extreme_light_is_a_number_and_counts_as_noise(variant_rgb, radiance):
    scene = penumbra(size=16, type="prosim", aovs="samples,error")
    scene["light"]["emitter"]["radiance"] = {"type": "rgb", "value": radiance}
    image = np.array(mi.render(mi.load_dict(scene)))
    assert np.all(np.isfinite(image))
    assert np.mean(image[..., -2] == 25) > 0.8


def test_black_light_is_light_in_spectral_variants_too(variant_spectral):
    scene = penumbra(size=4, type="prosim", ambient={"type": "rgb", "value": [0, 0, 0]}, background=0.0)
    assert np.array(mi.render(mi.load_dict(scene), spp=4)).max() > 0


@pytest.mark.parametrize(
    "size, aovs, measure, most",
    [
        ((8000, 6000), "", None, "40.8"),
        ((6000, 4500), "", "halves", "20.4"),
        ((6000, 4500), "d:depth,n:sh_normal", None, "20.4"),
    ],
    ids=["wide filter", "two halves", "many channels"],
)
def test_image_with_too_many_sums_is_refused_in_words(variant_rgb, size, aovs, measure, most):
    scene = loaded(rfilter="gaussian", aovs=aovs, film={"width": size[0], "height": size[1]})
    with pytest.raises(ValueError, match=rf"{size[0]} x {size[1]} pixels are too many .* {most} million.* crops"):
        scene.integrator().progressive(scene, measure=measure)


def test_a_frozen_function_is_refused(variant_rgb):
    scene = mi.load_dict(penumbra(size=4, type="prosim"))

    @dr.freeze
    def frozen(seed):
        return mi.render(scene, seed=seed)

    with pytest.raises(RuntimeError) as error:
        frozen(mi.UInt32(1))
    assert "dr.freeze" in "".join(traceback.format_exception(error.value))


SHAPES = [{"type": "sphere", "center": [0, 0, 2]}, {"type": "rectangle", "flip_normals": True}, {"type": "cube"}]
SHAPES += [{"type": "cylinder", "flip_normals": flipped} for flipped in (False, True)]


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@alone()  # see alone: the collector must not free scenes while a kernel is traced
def test_lamps_light_in_a_frozen_function(variant_rgb, shape):
    """A recorded function can't read the area and the transform of a shape; its light is still that of ``area``."""
    to_world = mi.ScalarTransform4f().translate([0, 0, 2])
    shape = shape if "center" in shape else shape | {"to_world": to_world}
    path, images = mi.load_dict({"type": "path", "max_depth": 2}), []
    for plugin in "area", "prosim_area":
        lamp = shape | {"emitter": {"type": plugin, "radiance": 3.0}}
        scene = load_scene(sensor=camera([0, 0, 9], [0, 0, 0], film(8)), card=rectangle(T().scale(9)), lamp=lamp)
        frozen = dr.freeze(lambda scene, seed: mi.render(scene, integrator=path, seed=seed, spp=64))
        radiance = mi.traverse(scene)
        images.append(np.array(frozen(scene, mi.UInt32(1))))
        radiance["lamp.emitter.radiance.value"] *= 2
        radiance.update()
        images.append(np.array(frozen(scene, mi.UInt32(1))))
    expected, doubled, found, double = (image.mean() for image in images)
    assert (found, doubled, double) == pytest.approx((expected, 2 * expected, 2 * expected), rel=0.02)


@pytest.mark.parametrize("glass", [{"int_ior": 1.5}, {"int_ior": 1.5, "int_abbe": 30.0}, {"alpha": 0.2}])
@alone()  # see alone: the collector must not free scenes while a kernel is traced
def test_glass_is_found_by_a_frozen_function(variant_rgb, glass):
    """Also its index, which is changed later."""
    scene, path = mi.load_dict(penumbra({"type": "prosim_dielectric", **glass}, 8)), mi.load_dict({"type": "path"})
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, integrator=path, seed=seed, spp=4))
    index = mi.traverse(scene)
    for _ in range(3):
        expected = np.array(mi.render(scene, integrator=path, seed=1, spp=4))
        assert np.allclose(frozen(scene, mi.UInt32(1)), expected, atol=1e-6)
        for name in {"ball.bsdf.eta", "ball.bsdf.int_A"} & {*index.keys()}:
            index[name] *= 1.1
        index.update()


@pytest.mark.parametrize("name, spp", [("nrook", 0), ("nrook", 36), ("owen", 0), ("owen", 36)])
@alone()  # see alone: the collector must not free scenes while a kernel is traced
def test_samplers_in_a_frozen_function(variant_rgb, name, spp):
    scene, path = penumbra(size=8), mi.load_dict({"type": "path"})
    scene["sensor"]["sampler"] = {"type": name, "sample_count": 25}
    scene = mi.load_dict(scene)
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, integrator=path, seed=seed, spp=spp))
    if name == "nrook" and spp:  # these permutations are new
        with pytest.raises(RuntimeError) as error:
            frozen(scene, mi.UInt32(0))
        assert "give the sampler sample_count = 36" in "".join(traceback.format_exception(error.value))
        mi.render(scene, integrator=path, spp=spp)
    for seed in 1, 2:
        expected = np.array(mi.render(scene, integrator=path, seed=seed, spp=spp))
        assert np.allclose(frozen(scene, mi.UInt32(seed)), expected, atol=1e-5)  # another kernel rounds differently


# ---- The order of lamps and of what is specular: Mitsuba gives meshes another one whenever it loads a scene


TREES = {"type": "prosim", "adaptive": "none", "samples": 2}
PATHS = TREES | {"max_level": -1, "diffuse_bounces": -1}
CAUSTICS = {"caustics": True, "caustic_photons": 2000}


def cube(x, y, size, inside):
    return f"""<shape type="cube"><transform name="to_world"><scale value="{size}"/>
        <translate x="{x}" y="{y}" z="{0.3 * x}"/></transform>{inside}</shape>"""


def lamp(k):
    return f"""<bsdf type="diffuse"/><emitter type="area">
        <rgb name="radiance" value="{1 + k % 2}, {1 + k % 3}, {2 + k}"/></emitter>"""


def glass(k):
    return f'<bsdf type="dielectric"><float name="int_ior" value="{1.3 + 0.1 * k}"/></bsdf>'


@pytest.fixture
def xml(write_scene):
    """A scene with six lamps and four pieces of glass, all of them meshes without names."""
    scene = f"""<scene version="3.0.0">
        <integrator type="path"/>
        <sensor type="perspective">
            <transform name="to_world"><lookat origin="0,4,9" target="0,0,0" up="0,1,0"/></transform>
            <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film>
        </sensor>
        <shape type="rectangle">
            <transform name="to_world"><scale value="8"/><rotate x="1" angle="-90"/></transform>
        </shape>
        <shape type="sphere"><point name="center" x="0" y="4" z="2"/><float name="radius" value="0.1"/>{lamp(3)}</shape>
        {"".join(cube(k - 2.5, 3, 0.15, lamp(k)) for k in range(6))}
        {"".join(cube(1.5 * k - 2, 0.4, 0.3, glass(k)) for k in range(4))}
    </scene>"""
    return write_scene(scene, "lamps.xml")


@pytest.mark.parametrize("integrator", [TREES | CAUSTICS, *slow(PATHS | CAUSTICS)])
def test_a_scene_has_one_image_however_often_it_is_loaded(variant_rgb, xml, integrator):
    loaded = [mi.load_file(str(xml)) for _ in range(3)]  # all of them alive, and so at other addresses
    images = {np.array(mi.render(scene, integrator=mi.load_dict(integrator), seed=3)).tobytes() for scene in loaded}
    assert len(images) == 1


def test_scene_of_another_integrator_has_one_image_however_often_it_is_loaded(variant_rgb, xml, tmp_path):
    file = SceneFile(xml, tmp_path, integrator={"adaptive": "none", "samples": 2})
    loaded = [file.load() for _ in range(3)]
    assert len({np.array(mi.render(scene, seed=3)).tobytes() for scene in loaded}) == 1
    assert all(len(scene.emitters()) == 7 and len(scene.shapes()) == 12 for scene in loaded)


def test_meshes_of_one_material_are_merged(variant_rgb, tmp_path, write_scene):
    cubes = "".join(cube(k, 0, 0.1, glass(0)) for k in range(5)) + cube(5, 0, 0.1, lamp(0)) + cube(6, 0, 0.1, lamp(0))
    path = write_scene(f'<scene version="3.0.0">{cubes}</scene>', "cubes.xml")
    assert sorted(s.primitive_count() for s in SceneFile(path, tmp_path).load().shapes()) == [12, 12, 60]
