"""The prosim_adaptive integrator: another integrator's image, by our samples (chapter 4, sections 4.2.1 and 5.3.2)."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from scenes import COPPER, CROP, camera, derivative, film, ground, in_threads, load_scene, penumbra, rgb


def adaptive(nested, **settings):
    """The integrator's entry around ``nested``, the name of one or its entry."""
    nested = {"type": nested} if isinstance(nested, str) else nested
    return {"type": "prosim_adaptive", "nested": nested, "adaptive": "graded", **settings}


def compare(scene, nested, spp=64):
    """Whether ``nested`` by itself and within ours may have the same expectation in ``scene``."""
    integrator = adaptive(nested)
    alone = renderings({**scene, "integrator": integrator["nested"]}, 8, spp=spp)
    ours = renderings({**scene, "integrator": integrator}, 8, first_seed=1000)
    return same_expectation(alone, ours[..., : alone.shape[3]])


# ------------------------------------------------------------------ the nested integrator's image


def test_the_expectation_is_that_of_path(variant_rgb):
    assert compare(penumbra(COPPER), "path")


@pytest.mark.slow
def test_the_expectation_is_that_of_volpath_with_the_camera_in_a_medium(variant_rgb):
    scene, fog = penumbra(COPPER), {"type": "homogeneous", "albedo": 0.7, "sigma_t": 0.25}
    scene["sensor"]["medium"] = scene["floor"]["exterior"] = scene["wall"]["exterior"] = fog
    assert compare(scene, {"type": "volpath", "max_depth": 6}, spp=25)


def test_scalar_variants_render_as_the_nested_integrator_does(variant_scalar):
    """By the sensor's sampler, so to the bit."""
    scene = mi.load_dict(penumbra(COPPER, size=8))
    alone, ours = (
        np.array(mi.render(scene, integrator=mi.load_dict(i), spp=4)) for i in ({"type": "path"}, adaptive("path"))
    )
    assert np.array_equal(alone, ours) and alone.max() > 0


# ------------------------------------------------------------------ channels


def test_channels_of_the_nested_integrator_come_first(variant_rgb):
    """Then those that ``aovs`` asks for; each with the values of Mitsuba's own."""
    nested = {"type": "aov", "aovs": "d:depth", "image": {"type": "path"}}
    integrator = mi.load_dict(adaptive(nested, aovs="n:sh_normal,samples,error"))
    assert integrator.aov_names() == (
        ["image.R", "image.G", "image.B", "image.A", "d.T", "n.X", "n.Y", "n.Z", "samples", "error"]
    )
    scene = mi.load_dict(penumbra(COPPER))
    image = np.array(mi.render(scene, integrator=integrator))
    assert image.shape == (32, 32, 3 + 6)  # the film has the channels of the nested ``path`` too
    film = scene.sensors()[0].film().bitmap().struct_()
    assert [field.name for field in film] == ["R", "G", "B", *integrator.aov_names()]
    reference = mi.load_dict({"type": "aov", "aovs": "d:depth,n:sh_normal"})
    expected = np.array(mi.render(scene, integrator=reference, spp=256))[..., -4:]
    assert np.allclose(image[-4:, :8, 3:7], expected[-4:, :8], rtol=0.02, atol=1e-6)
    assert image[..., -2].min() >= 5 and image[..., -2].max() > 25 and image[..., -1].max() > 0


@pytest.mark.parametrize("sensor", ["perspective", "orthographic"])
def test_partials_of_texture_coordinates_are_those_of_aov(variant, sensor):
    """In ``prosim``, and in the nested ``aov``: the size of a pixel on the floor, scaled as Mitsuba scales it."""
    pixel = camera([0, 2, 0.1], [0, 0, 0], film(1, component_format="float32")) | {"type": sensor}
    scene = load_scene(sensor=pixel, floor=ground(9, {"type": "diffuse"}))
    aov = {"type": "aov", "aovs": "x:duv_dx,y:duv_dy"}
    images = [
        np.array(mi.load_dict(integrator).render(scene, spp=16))[..., -4:]
        for integrator in (aov, {"type": "prosim", "aovs": aov["aovs"]}, adaptive(aov))
    ]
    assert np.abs(images[0]).max() > 0.01
    for image in images[1:]:
        assert np.allclose(image, images[0], rtol=0.03, atol=1e-4)


# ------------------------------------------------------------------ the same image, bit by bit


def image(rfilter="gaussian", band=1 << 18, settings=None, **film):
    scene = penumbra(COPPER, rfilter=rfilter, **adaptive("path", band=band, aovs="samples", **(settings or {})))
    scene["sensor"]["film"] |= {"width": 40, "height": 24, **film}
    return np.array(mi.render(mi.load_dict(scene), seed=3))


def test_bands_and_crops_do_not_change_a_bit(variant_rgb):
    whole = image()
    assert len(np.unique(whole[..., -1])) > 2
    assert np.array_equal(whole, image(band=333))
    assert np.array_equal(whole[11:20, 7:27], image(**CROP))


@pytest.mark.slow
def test_with_a_noise_to_reach_bands_and_threads_do_not_change_a_bit(variant_rgb):
    whole = image(settings={"noise": 0.01})
    assert np.array_equal(whole, in_threads(3, image, settings={"noise": 0.01}, band=100))


# ------------------------------------------------------------------ derivatives


@pytest.mark.parametrize("method", ["render_forward", "render_backward"])
def test_derivatives_refuse_to_omit_colours(variant_rgb, method):
    scene, ours = mi.load_dict(penumbra(COPPER)), mi.load_dict(adaptive("prb", channels="r"))
    given = [dr.ones(mi.TensorXf, (32, 32, 3))] if method == "render_backward" else []
    with pytest.raises(RuntimeError, match='leave out channels = "r"'):
        getattr(ours, method)(scene, mi.traverse(scene), *given)


@pytest.mark.slow
def test_derivatives_are_the_nested_integrators(variant_rgb):
    """Forward to the bit; backward but for the order of the sums."""
    scene, nested = mi.load_dict(penumbra(COPPER)), mi.load_dict({"type": "prb"})
    ours, params = mi.load_dict(adaptive("prb", aovs="samples")), mi.traverse(scene)

    def image(e, integrator):
        params["floor.bsdf.reflectance.value"] = mi.Color3f(0.6, 0.6, 0.5) + e
        params.update()
        return mi.render(scene, params, integrator=integrator, seed=1, seed_grad=2, spp=4)

    forward = []
    for integrator in (nested, ours):
        e = mi.Float(0)
        dr.enable_grad(e)
        found = image(e, integrator)
        dr.forward(e)
        forward.append(np.array(dr.grad(found)))
    assert np.array_equal(forward[1][..., :3], forward[0]) and forward[0].max() > 0
    assert forward[1].shape == (32, 32, 4) and forward[1][..., 3].max() == 0
    of_nested, of_ours = (derivative(lambda e, i=i: dr.sum(image(e, i)[..., :3], axis=None)) for i in (nested, ours))
    assert of_ours == pytest.approx(of_nested, rel=1e-4) and of_ours == pytest.approx(forward[0].sum(), rel=1e-4)


def test_parameters_of_the_nested_integrator_are_found(variant_rgb):
    integrator = mi.load_dict(adaptive({"type": "prosim", "ambient": rgb(0.1, 0.2, 0.3)}))
    params = mi.traverse(integrator)
    assert np.array(params["nested.ambient.value"]) == pytest.approx([0.1, 0.2, 0.3])


# ------------------------------------------------------------------ wrong inputs


def test_polarised_light_is_refused():
    mi.set_variant("scalar_spectral_polarized")
    for integrator in adaptive("path"), {"type": "prosim"}, {"type": "prosim_features"}:
        with pytest.raises(RuntimeError, match=f"{integrator['type']}: light is unpolarised here"):
            mi.load_dict(integrator)


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "prosim"},
        adaptive("path"),
        {"type": "prosim_features"},
        {"type": "prosim_denoised", "nested": {"type": "path"}},
        {"type": "prosim_denoised", "nested": {"type": "prosim"}},
    ],
    ids=["prosim", "prosim_adaptive", "prosim_features", "denoised path", "denoised prosim"],
)
def test_images_without_samples_are_refused(variant, integrator):
    """A negative number, and the number 0 of a sampler that the integrator uses: Mitsuba would end the process."""
    mi.set_variant(variant)
    scene = penumbra(size=4)
    scene["sensor"]["sampler"] = {"type": "independent", "sample_count": 0}
    scene, integrator = mi.load_dict(scene), mi.load_dict(integrator)
    with pytest.raises(ValueError, match="spp is -3; allowed: a whole number from 0"):
        integrator.render(scene, spp=-3)
    nested = getattr(integrator, "nested", None)
    if variant == "scalar_rgb" or not any(hasattr(each, "progressive") for each in (integrator, nested)):
        with pytest.raises(ValueError, match="sample_count = 0 samples per pixel; give 1 or more"):
            integrator.render(scene)


def test_direct_that_brightens_point_lamps_causes_a_warning(variant_rgb, logged):
    lamp = {"type": "point", "position": [0, 0, 2]}
    scene = load_scene(sensor=camera([0, 0, 4], [0, 0, 0], film(1)), card={"type": "rectangle"}, lamp=lamp)
    images = []
    for count in (1, 3):
        assert not logged
        inner = {"type": "aov", "aovs": "d:depth", "image": {"type": "direct", "emitter_samples": count}}
        images.append(mi.load_dict({"type": "prosim_adaptive", "nested": inner}).render(scene, spp=1))
    ((_, text),) = logged
    assert "'lamp' will be 3 times too bright" in text
    assert dr.allclose(images[1][..., :3] / images[0][..., :3], 3)  # the fault of Mitsuba


@pytest.mark.parametrize("nested, warned", [("plastic", True), ("roughplastic", False), ("roughdielectric", True)])
def test_blend_that_path_renders_wrongly_causes_one_warning(variant, logged, nested, warned):
    """Mitsuba's ``blendbsdf`` adds densities of smooth lobes to those of ideal ones, and counts discarded samples."""
    blend = {"type": "blendbsdf", "weight": 0.5, "a": {"type": nested}, "b": {"type": "diffuse"}}
    scene = load_scene(sensor=camera([0, 0, 4], [0, 0, 0], film(1)), card={"type": "rectangle", "bsdf": blend})
    mi.load_dict({"type": "prosim_adaptive", "nested": {"type": "path"}}).render(scene, spp=1)
    assert sum("blendbsdf" in text for _, text in logged) == len(logged) == warned


@pytest.mark.slow
@pytest.mark.parametrize("sky, wrapper", [(False, None), (True, None), (False, "aov"), (True, "hide")])
def test_mask_before_nothing_that_path_darkens_causes_a_warning(variant, logged, sky, wrapper):
    """Mitsuba's ``path`` returns black if it passes only holes, also for the light of the surface around a hole."""
    mask = {"type": "mask", "id": "leaf", "opacity": 0.5, "bsdf": {"type": "diffuse"}}
    more = {"sky": {"type": "constant", "radiance": 1e-6}} if sky else {}
    lamp = {"type": "point", "position": [0, 0, 2]}
    pixel = camera([0, 0, 4], [0, 0, 0], film(1))
    scene = load_scene(sensor=pixel, card={"type": "rectangle", "bsdf": mask}, lamp=lamp, **more)
    path = {"type": "path", "hide_emitters": wrapper == "hide"}
    nested = {"type": "aov", "aovs": "d:depth", "image": path} if wrapper == "aov" else path
    found, right = (
        np.array(mi.load_dict({"type": "prosim_adaptive", "nested": each}).render(scene, spp=1024))[..., :3].mean()
        for each in (nested, {"type": "direct"})
    )
    wrong = found != pytest.approx(right, rel=0.2)  # the fault of Mitsuba: half of the light
    assert sum("'leaf' may reflect too little" in text for _, text in logged) == len(logged) == wrong
    assert wrong == (not sky or wrapper == "hide")
