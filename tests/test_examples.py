"""The figures are drawn, and 5.12 to 5.15 show what the thesis says of them, in numbers."""

import functools
from pathlib import Path

import figures
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from drawing import scenes
from scipy import ndimage

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCENES = sorted(EXAMPLES.glob("*.scn"))
FIGURES = [*figures.DRAWN, *figures.RENDERED]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_nothing_in_a_scene_is_doubtful(path, recwarn):
    prosim_scene.check(path)
    assert not [w for w in recwarn if issubclass(w.category, prosim_scene.SceneWarning)]


@pytest.mark.parametrize(
    "name",
    [
        *figures.DRAWN,
        pytest.param("5.14-samples", marks=pytest.mark.slow),
        pytest.param("5.18-path", marks=pytest.mark.slow),
    ],
)
def test_figure_is_drawn(variant_rgb, tmp_path, name):
    path = tmp_path / f"{name}.png"
    if name == "5.18-path":  # 16 samples instead of its many
        image = scenes.render_path("caustica", 0.1, 16)
    else:
        figures.draw(name, path, 0.1)
        image = np.array(mi.Bitmap(str(path)))
    assert image.ndim == 3 and image.shape[0] >= 24
    assert np.all(np.isfinite(image)) and image.std() > 0


@pytest.mark.parametrize("name", FIGURES)
def test_gallery_shows_every_figure(name):
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    shown = [p for p in (ROOT / "docs" / "gallery").iterdir() if p.stem == name]
    assert len(shown) == 1 and f"gallery/{shown[0].name}" in page


# ---- 5.12 to 5.15 ----------------------------------------------------------------------------------------------------


def pole(name, samples, **integrator):
    """Luminance of the pole, (180, 240), and the further channels."""
    return rendered_pole(mi.variant(), name, samples, **integrator)


@functools.cache
def rendered_pole(variant, name, samples, **integrator):
    """The same, rendered once in each variant."""
    scene = mi.load_dict(scenes.load(name, 0.5, samples, **integrator))
    image = np.array(mi.render(scene))
    return (image[..., :3] @ [0.2126, 0.7152, 0.0722], *np.moveaxis(image[..., 3:], 2, 0))


@pytest.fixture
def converged(variant_rgb):
    """Images of 256 samples in the light of the point and of the extended source."""
    return tuple(pole(name, 16, adaptive="none")[0] for name in ("poste-pontual", "poste"))


@pytest.fixture
def regions(converged):
    """Masks: outlines of things; penumbra, where the size of the source matters, without these; what is flat."""
    point, extended = converged
    outline = ndimage.gaussian_gradient_magnitude(extended, 0.5) > 0.06
    near = ndimage.binary_dilation(outline, iterations=2)
    penumbra = (np.abs(extended - point) > 0.03) & ~near
    # A pixel is flat if the 5 x 5 around it are, as far as the criterion looks.
    uneven = (np.abs(extended - point) >= 0.001) | (ndimage.gaussian_gradient_magnitude(extended, 0.5) >= 0.01)
    flat = ~ndimage.binary_dilation(outline | uneven, np.ones((5, 5)))
    assert min(outline.sum(), penumbra.sum(), flat.sum()) > 500
    return outline, penumbra, flat


def rmse(image, reference, where):
    return np.sqrt(np.mean((image - reference)[where] ** 2))


@pytest.mark.slow
def test_one_sample_from_a_point_source_has_stairs_but_no_noise(converged, regions):
    """Figure 5.12: hard steps along the outlines, clean surfaces and shadows."""
    outline, _, flat = regions
    image = pole("poste-pontual", 1)[0]
    assert rmse(image, converged[0], outline) > 0.05
    assert rmse(image, converged[0], flat) < 0.01


@pytest.mark.slow
def test_extended_source_is_noisy_in_the_shadow_at_one_sample(converged, regions):
    """Figure 5.13: the penumbra is many times noisier than what is flat, and than in the light of the point source."""
    _, penumbra, flat = regions
    image = pole("poste", 1)[0]
    assert rmse(image, converged[1], penumbra) > 0.05
    assert rmse(image, converged[1], flat) < 0.2 * rmse(image, converged[1], penumbra)
    assert rmse(pole("poste-pontual", 1)[0], converged[0], penumbra) < 0.5 * rmse(image, converged[1], penumbra)


@pytest.mark.slow
def test_more_samples_mean_less_of_both(converged, regions):
    """Figures 5.14 and 5.15: stairs and noise shrink from 1 sample to at most 9, and to at most 25."""
    for region in regions[:2]:
        error = [rmse(pole("poste", n)[0], converged[1], region) for n in (1, 3, 5)]
        assert error[1] < 0.5 * error[0] and error[2] < 0.8 * error[1]


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 5])
def test_samples_go_where_they_are_needed(regions, n):
    """N on what is flat, up to N² on outlines and in the penumbra (section 5.3.2)."""
    outline, penumbra, flat = regions
    counts = pole("poste", n, aovs="samples")[1]
    assert counts.min() == n and counts.max() == n * n
    assert np.mean(counts[flat] == n) > 0.95
    assert np.mean(counts[outline] == n * n) > 0.9
    assert np.mean(counts[penumbra] == n * n) > 0.6
