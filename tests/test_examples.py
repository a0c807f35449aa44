"""The figures are drawn, and show what the thesis says of them, in numbers; the notebooks run."""

import importlib
import re
from pathlib import Path

import figures
import mitsuba as mi
import nbformat
import numpy as np
import pytest
from drawing import scenes as drawn
from drawing.patterns import SPACING, jittered, nrook, poisson_disk, regular, uncorrelated_jittered
from nbclient import NotebookClient
from PIL import Image
from scenes import slow
from scipy import ndimage

ROOT = Path(__file__).parents[1]
#: The figures of a quick run.
QUICK = ("2.4-dieletrico", "3.3-beckmann", "4.3-disco-de-poisson", "5.10-associacao")


SLOW = "5.14-samples", "5.18-path", *(name for name in figures.DRAWN if name not in QUICK)


@pytest.mark.parametrize("name", [*QUICK, *slow(*SLOW)])
def test_figure_is_drawn(variant_rgb, tmp_path, name):
    path = tmp_path / f"{name}.png"
    if name == "5.18-path":  # 16 samples instead of its many
        image = drawn.render_path("caustica", 0.1, 16)
    else:
        figures.draw(name, path, 0.1)
        image = np.array(mi.Bitmap(str(path)))
    assert image.ndim == 3 and image.shape[0] >= 24
    assert np.all(np.isfinite(image)) and image.std() > 0


def test_page_shows_every_figure():
    page = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")
    for name in (*figures.DRAWN, *figures.RENDERED):
        (shown,) = (path for path in (ROOT / "docs" / "gallery").iterdir() if path.stem == name)
        assert f"gallery/{shown.name}" in page


def test_pictures_of_the_gallery_are_large():
    pictures = re.findall(r"\]\((gallery/.*?\.jpg)\)", (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"))
    assert len(pictures) == 10
    for picture in pictures:
        path = ROOT / "docs" / picture
        assert Image.open(path).width >= 960 and path.stat().st_size < 250_000


def luminance(name, samples, **integrator):
    """Luminance of a scene of the pole, (108, 144), and the further channels."""
    image = np.array(mi.render(mi.load_dict(drawn.load(name, 0.3, samples, **integrator))))
    return (image[..., :3] @ [0.2126, 0.7152, 0.0722], *np.moveaxis(image[..., 3:], 2, 0))


@pytest.mark.slow
def test_samples_in_the_light_of_a_pole(variant_rgb):
    """Figures 5.12 to 5.15, and section 5.3.2."""
    point, extended = (luminance(name, 16, adaptive="none")[0] for name in ("poste-pontual", "poste"))
    # Masks: outlines of things; penumbra, where the size of the source matters, without these; what is flat.
    outline = ndimage.gaussian_gradient_magnitude(extended, 0.5) > 0.06
    penumbra = (np.abs(extended - point) > 0.03) & ~ndimage.binary_dilation(outline, iterations=2)
    # A pixel is flat if the 5 x 5 around it are, as far as the criterion looks.
    uneven = (np.abs(extended - point) >= 0.001) | (ndimage.gaussian_gradient_magnitude(extended, 0.5) >= 0.01)
    flat = ~ndimage.binary_dilation(outline | uneven, np.ones((5, 5)))
    assert min(outline.sum(), penumbra.sum(), flat.sum()) > 180

    def rmse(image, reference, where):
        return np.sqrt(np.mean((image - reference)[where] ** 2))

    # Of a point source: hard steps along the outlines, clean surfaces and shadows.
    image = luminance("poste-pontual", 1)[0]
    assert rmse(image, point, outline) > 0.05 and rmse(image, point, flat) < 0.01
    # Of an extended one: the penumbra is many times noisier than what is flat, and than in the light of the point.
    noisy, *finer = (luminance("poste", n, aovs="samples") for n in (1, 3, 5))
    assert rmse(noisy[0], extended, penumbra) > 0.05
    assert rmse(noisy[0], extended, flat) < 0.2 * rmse(noisy[0], extended, penumbra)
    assert rmse(image, point, penumbra) < 0.5 * rmse(noisy[0], extended, penumbra)
    # Stairs and noise shrink from 1 sample to at most 9, and to at most 25.
    for region in (outline, penumbra):
        error = [rmse(image, extended, region) for image, _ in (noisy, *finer)]
        assert error[1] < 0.5 * error[0] and error[2] < 0.8 * error[1]
    # N on what is flat, up to N² on outlines and in the penumbra.
    for n, (_, counts) in zip((3, 5), finer):
        assert counts.min() == n and counts.max() == n * n
        assert np.mean(counts[flat] == n) > 0.95
        assert np.mean(counts[outline] == n * n) > 0.9
        assert np.mean(counts[penumbra] == n * n) > 0.6


# The sampling strategies of section 4.2.1.2: what defines each


@pytest.mark.parametrize("pattern", [regular, jittered, uncorrelated_jittered], ids=lambda f: f.__name__)
def test_each_cell_is_hit_once(pattern):
    cells = np.floor(pattern(25, np.random.default_rng(2)) * 5).astype(int)
    assert sorted(map(tuple, cells)) == [(i, j) for i in range(5) for j in range(5)]


def test_nrook_has_one_sample_a_row_and_a_column():
    points = np.array([nrook(7, np.random.default_rng(seed)) for seed in range(50)])
    assert np.all(np.sort(np.floor(points * 7), axis=1) == np.arange(7)[:, None])
    assert len(np.unique(np.floor(points * 7), axis=0)) == 50  # and not the same ones each time


def test_poisson_disk_samples_keep_their_distance():
    points = poisson_disk(100, np.random.default_rng(3))
    apart = np.abs(points[:, None] - points)
    apart = np.hypot(*np.moveaxis(np.minimum(apart, 1 - apart), 2, 0)) + np.eye(100)
    assert SPACING / 10 <= apart.min() < 1.05 * SPACING / 10


def test_uncorrelated_jittering_associates_spaces_at_random():
    """Cells of equal index agree in two jittered spaces; uncorrelated ones correlate as random numbers do."""
    rng = np.random.default_rng(4)
    pairs = [(f(100, rng)[:, 0], f(100, rng)[:, 0]) for f in (jittered, uncorrelated_jittered)]
    same, mixed = (np.corrcoef(a, b)[0, 1] for a, b in pairs)
    assert same > 0.95 and abs(mixed) < 0.33  # 3.3 standard deviations of 1/sqrt(99)


# Notebooks: each runs from its first cell to its last, at small size, and is stored with the outputs of its code

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, monkeypatch):
    monkeypatch.setenv("PROSIM_SMALL", "1")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(path.parent)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in outputs if output.get("name") == "stderr"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_has_the_outputs_of_its_code(path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "extensions")
    code_hash = importlib.import_module("notebook_pages").code_hash
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata.get("outputs_of") == code_hash(notebook), (
        f"run python docs/extensions/notebook_pages.py, which stores new outputs in {path.name}"
    )
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == [*range(1, len(counts) + 1)]
    assert any(cell.get("outputs") for cell in notebook.cells) and path.stat().st_size < 400_000
