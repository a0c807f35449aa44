"""The figures are drawn, and their sampling patterns are what the thesis says; the notebooks run."""

import importlib
import re
from pathlib import Path

import figures
import mitsuba as mi
import nbformat
import numpy as np
import pytest
import reference_pictures as references
from drawing import scenes as drawn
from drawing.patterns import SPACING, jittered, nrook, poisson_disk, regular, uncorrelated_jittered
from image_statistics import leave
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["5.14-samples", "5.18-path", *figures.DRAWN])
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


# ---- The examples look as they did: each beside a reference picture, with a tolerance for rounding alone


#: The scenes of a quick run: the thesis's own, and one with glass.
QUICK_SCENES = ("caustica", "palito")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK_SCENES else pytest.mark.slow) for name in references.NAMES]
)
@pytest.mark.filterwarnings("error::prosim_scene.SceneWarning")
def test_example_is_its_reference(variant_rgb, name):
    """And nothing in it is doubtful."""
    if name == "palito" and mi.__version__ == "3.9.0":
        pytest.skip("tangents of meshes, which say how large a pixel is on the stripes, are those of Mitsuba 3.9.1")
    image, reference = references.render(name), references.kept(name)
    keep = f"python tests/reference_pictures.py --keep {name}"
    assert reference is not None, f"tests/references has no {name}.exr: {keep}"
    if not references.same(image, reference):
        pixels, mean, largest = references.changes(image, reference)
        note = f"{pixels:.1%} of the pixels have changed, the mean by {mean:.2%}, one by {largest:.1%}"
        folder = leave(note, image=image, reference=reference, difference=image - reference)
        pytest.fail(f"{note}. See {folder}. If that is as it should be: {keep}")


def test_tolerance_tells_rounding_from_light(variant_rgb):
    """One per cent more light is seen, in any example; rounding to 16 bits, and every 200th pixel another, are not."""
    for reference in map(references.kept, references.NAMES):
        rng = np.random.default_rng(0)
        assert not references.same(1.01 * reference, reference)
        rounded = reference * (1 + rng.uniform(-1, 1, reference.shape) / 2048)
        other = rng.random(reference.shape[:2]) < 0.005
        rounded[other] *= rng.uniform(0.9, 1.1, (other.sum(), 1))
        assert references.same(rounded, reference)
