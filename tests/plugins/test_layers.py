"""Layers of lamps: their sum is the image, and each is what a render of that lamp alone shows."""

import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from mitsuba_prosim.transport import radiance as layers
from scenes import T, area, penumbra, rectangle, rgb, sphere_lamp, without

ROUGH = {"type": "roughconductor", "alpha": 0.2}
GLASS = {"type": "roughdielectric", "alpha": 0.1}
LAMPS = {
    "light": sphere_lamp([-3, 3.5, 3], 0.5, rgb(25, 20, 15)),
    "point": {"type": "point", "position": [2, 3, 2], "intensity": rgb(6, 7, 8)},
    "panel": {"type": "rectangle", **area(9.0)},
    "sky": {"type": "constant", "radiance": rgb(0.1, 0.2, 0.3)},
}


def lamps(*shining):
    """All lamps; where any are named, the others are black, and still in the way."""
    place = T().look_at([0, 4, 3], [0, 0, 0], [0, 0, 1]).scale(0.4)
    made = LAMPS | {"panel": rectangle(place, **area(9.0))}
    dark = set(LAMPS) - set(shining or LAMPS)
    black = {name: made[name] | area(0.0) for name in dark if "emitter" in made[name]}
    return without(made, *dark) | black


def scene(ball=ROUGH, light=None, size=16, **integrator):
    settings = {"type": "prosim", "samples": 3, "adaptive": "none", "max_level": 2}
    return without(penumbra(ball, size, **settings | integrator), "light") | (lamps() if light is None else light)


def rendered(description, seed=0):
    """``(image, layers)``: the image, and that of each layer by its name."""
    loaded = mi.load_dict(description)
    image = np.array(loaded.integrator().render(loaded, seed=seed))
    names = [field.name for field in loaded.sensors()[0].film().bitmap().struct_()]
    letters = {name: image[..., k] for k, name in enumerate(names)}
    found = dict.fromkeys(name[:-2] for name in names if "." in name)
    return image[..., :3], {name: np.stack([letters[f"{name}.{c}"] for c in "RGB"], -1) for name in found}


MORE = {"ambient": 0.3, "background": rgb(0.1, 0.2, 0.3), "hide_emitters": True}


@pytest.mark.slow
@pytest.mark.parametrize("bounces, more", [(-1, {}), (0, MORE)])
def test_the_sum_of_layers_is_the_image_without_layers(variant_rgb, bounces, more):
    description = without(scene(GLASS, diffuse_bounces=bounces, **more), *["sky"] * bool(more))
    alone, _ = rendered(description)
    description["integrator"] |= {"layers": "lights"}
    image, parts = rendered(description)
    assert np.array_equal(image, alone)
    assert np.allclose(sum(parts.values()), image, atol=1e-5 * image.max())


def test_the_sum_is_the_image_in_spectra_and_among_many_lamps(variant_spectral):
    many = {f"lamp_{k}": LAMPS["point"] | {"position": [k - 3.0, 3.0, 2.0]} for k in range(6)}
    image, parts = rendered(scene(light=many | lamps(), layers="lights"))
    assert image.max() > 0.1
    assert np.allclose(sum(parts.values()), image, atol=1e-4 * image.max())


@pytest.mark.slow
@pytest.mark.parametrize("ball, bounces", [(GLASS, -1), ({"type": "conductor"}, 3)], ids=str)
def test_the_layer_of_a_lamp_has_the_expectation_of_a_render_with_it_alone(variant_rgb, ball, bounces):
    """Significance 0.001 for each of 20 pairs of images: 1 run in 50 would fail by chance, were seeds not fixed."""
    settings = {"diffuse_bounces": bounces, "samples": 4}
    parts = [rendered(scene(ball, layers="lights", **settings), seed)[1] for seed in range(10)]
    for name in LAMPS:
        single = renderings(scene(ball, lamps(name), **settings), 10, first_seed=100)
        assert same_expectation(single, np.stack([part[name] for part in parts]), significance=1e-3)


@pytest.mark.slow
def test_the_layers_of_lamps_recombine_to_a_new_render(variant_rgb):
    _, parts = rendered(scene(layers="lights"))
    dimmed = LAMPS["light"] | area(rgb(12.5, 10, 7.5))
    image, _ = rendered(scene(light=lamps() | {"light": dimmed}))
    assert np.allclose(sum(parts.values()) - 0.5 * parts["light"], image, atol=1e-5 * image.max())


def test_many_layers_derivatives_and_nesting_are_refused(variant_rgb):
    many = {f"lamp{k}": LAMPS["point"] for k in range(layers.MAX_LAYERS + 1)}
    with pytest.raises((ValueError, RuntimeError), match="33 layers"):
        rendered(scene(light=many, layers="lights"))
    loaded = mi.load_dict(scene(layers="lights"))
    with pytest.raises(RuntimeError, match="derivatives"):
        loaded.integrator().render_forward(loaded, mi.traverse(loaded))
    with pytest.raises(RuntimeError, match="within another"):
        loaded.integrator().sample(loaded, None, None)


def test_lamps_without_names_are_numbered(variant_rgb):
    plain = mi.load_string(
        """<scene version="3.0.0"><emitter type="point"/><emitter type="point" id="a.b"/>
        <shape type="sphere"><emitter type="area" id="bulb"/></shape>
        <shape type="sphere" id="ball"><emitter type="area" id="c"/></shape></scene>"""
    )
    assert sorted(layers.light_names(plain.emitters())) == ["a_b", "ball", "bulb", "lamp1"]
