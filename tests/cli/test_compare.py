"""``prosim compare``: its measures against known values, its page against its own figures."""

import re
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim.cli.terminal import Progress
from mitsuba_prosim.compare import comparison, measures
from mitsuba_prosim.compare.methods import ComparedScene, Spec
from mitsuba_prosim.scene.scene_file import SceneFile
from running import LIT_FLOOR, done, refused, scene_text

SCENE = scene_text(
    """<integrator type="prosim">
        <integer name="samples" value="3"/>
        <rgb name="ambient" value="0.1, 0.1, 0.1"/> <rgb name="background" value="0.2, 0.3, 0.5"/>
    </integrator>""",
    LIT_FLOOR.replace("</transform>", '</transform><bsdf type="prosim_lambertian"/>'),
    16,
    12,
    "independent",
)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The page of a comparison at tiny size, and what the command prints."""
    folder, outside = tmp_path_factory.mktemp("compare"), tmp_path_factory.mktemp("outside") / "rc"
    (folder / "little.xml").write_text(SCENE)
    outside.write_text("mine")
    (folder / "little-compare.html").symlink_to(outside)  # which is replaced
    arguments = ["prosim", "path:multijitter", "--rounds", "2", "--exposure", "-1"]
    arguments += ["--reference-seconds", "0", "-m", "llvm_ad_rgb"]
    phases, show = set(), Progress.show
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Progress, "show", lambda bar, ready, phase: phases.add(phase) or show(bar, ready, phase))
        printed = done("compare", folder / "little.xml", *arguments).stdout
    assert {"reference of all paths", "rendering in turn"} <= phases
    assert not (folder / "little-compare.html").is_symlink() and outside.read_text() == "mine"
    return (folder / "little-compare.html").read_text("utf-8"), printed


# ---- measures


def mean_flip(image, reference):
    return measures.flip_map(image, reference).mean()


def test_measures_of_a_known_error():
    reference = np.full((16, 16, 3), 0.25)
    image = np.array(reference)
    image[:, :8] = 0.36
    assert measures.rmse(image, reference) == pytest.approx(0.11 / np.sqrt(2))


def test_measures_of_equal_images_and_order_of_unequal_ones():
    rng = np.random.default_rng(1)
    reference = rng.random((32, 32, 3))
    noise = rng.normal(size=reference.shape)
    for name, measure in ("rmse", measures.rmse), ("flip", mean_flip):
        equal, near, far = (measure(reference + s * noise, reference) for s in (0, 0.05, 0.3))
        assert far > near > equal == pytest.approx(0, abs=1e-6), name


# ---- runs


def converged(estimators, seconds=0.0):
    reference = comparison.Reference(estimators)
    assert list(reference.converge(seconds))[-1:] in ([], [1.0])
    return reference


def test_methods_in_words():
    spec = Spec("path:ldsampler,max_depth=5,hide_emitters=true,name=x")
    assert (spec.integrator, spec.sampler) == ("path", "ldsampler")
    assert spec.parameters == {"max_depth": 5, "hide_emitters": True, "name": "x"}
    assert Spec("prosim,noise=.5,adaptive=none").parameters == {"noise": 0.5, "adaptive": "none"}
    for wrong in ("path,max_depth", ":ldsampler", "path,=3"):
        with pytest.raises(ValueError, match=re.escape(repr(wrong)) + "|" + re.escape(repr(wrong.split(",")[-1]))):
            Spec(wrong)


@pytest.mark.slow
def test_real_sample_counts_and_the_same_expected_image(tmp_path, variant_rgb):
    path = tmp_path / "little.xml"
    path.write_text(SCENE)
    scene = ComparedScene(SceneFile(path, tmp_path))
    mi.set_log_level(mi.LogLevel.Error)
    assert scene.method(Spec("path:ldsampler"), "paths", spp=25).render(0)[1].mean() == 64
    assert scene.method(Spec("path:orthogonal"), "paths", spp=64).render(0)[1].mean() == 121
    counts = scene.method(Spec("prosim"), "scene").render(0)[1]
    assert counts.shape == (12, 16)
    assert set(np.unique(counts)) == {3, 9}
    for transport, integrator in ("paths", "path"), ("direct", "direct"):
        ours = scene.method(Spec("prosim,adaptive=none,samples=10"), transport)
        stock = scene.method(Spec(integrator + ":multijitter"), transport, spp=100)
        assert 0.6 < converged([ours, stock]).disagreement < 1.5


@pytest.mark.parametrize(
    "of_scene, a, b", [(-1, "prosim", "path,max_depth=5"), (-1, "path,max_depth=5", "prosim"), (5, "prosim", "path")]
)
def test_prosim_has_the_depth_of_the_other(tmp_path, variant_rgb, of_scene, a, b):
    path = tmp_path / "little.xml"
    path.write_text(scene_text(f'<integrator type="path"><integer name="max_depth" value="{of_scene}"/></integrator>'))
    compared = comparison.Comparison(ComparedScene(SceneFile(path, tmp_path)), Spec(a), Spec(b), 1, 0, 0)
    assert compared.methods["b" if b == "prosim" else "a"].integrator.max_level == 3


def test_sky_replaces_the_background(tmp_path, variant_rgb):
    """Mitsuba allows only one of them."""
    path = tmp_path / "little.xml"
    path.write_text(SCENE.replace("</scene>", '<emitter type="constant"/></scene>'))
    scene = ComparedScene(SceneFile(path, tmp_path))
    assert scene.method(Spec("path"), "paths").scene is scene.scene


def test_references_converge():
    class Noise:
        def render(self, seed):
            return np.random.default_rng(seed).normal(1, 0.1, (32, 32, 3)), 0, 0, 0

    first = converged([Noise()])
    assert first.passes == 3 and first.error == pytest.approx(0.1 / np.sqrt(3), rel=0.05)
    assert 0.9 < converged([Noise(), Noise()]).disagreement < 1.1  # equal methods have other samples
    longer = converged([Noise()], first.seconds + 0.2)
    assert longer.passes > 3
    assert longer.error < first.error


# ---- the page


@pytest.mark.slow
def test_comparison_page_has_all_rows_and_nothing_in_the_network(report):
    page, printed = report
    samples = [float(n) for n in re.findall(r"([\d.]+) samples ", printed)]
    assert "Light: all paths." in printed and "multijitter at equal time" in printed and len(samples) == 3
    assert samples[1] == pytest.approx(samples[0], abs=2)
    assert all(heading in page for heading in ["RMSE", "ꟻLIP", "at equal samples", "at equal time"])
    assert page.count("<figure") == page.count("data:image/png") == 1 + 3 * 3
    references = re.findall(r'\b(?:src|href)="([^"]*)"', page)
    assert references and all(reference.startswith(("data:image/", "#")) for reference in references)
    assert "url(" not in page and "@import" not in page and len(re.findall(r'<data value="[^"]*"', page)) > 20


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["nosuchintegrator"], '"nosuchintegrator" not found!'),
        (["prosim", "path:multijiter"], "'path:multijiter': failed to instantiate"),
        (["prosim", "path,max_dept=4,nom=x"], "path has no parameter max_dept, nom\n"),
        (["prosim,samples=-1"], "samples"),
        (["prosim,samples"], "PARAMETER=VALUE"),
        (["diffuse"], "'diffuse': diffuse is no integrator"),
    ],
)
def test_wrong_input_writes_nothing(tmp_path, arguments, message):
    """Also where the scene has no sampler that the given one could replace."""
    (tmp_path / "little.xml").write_text(re.sub("<sampler.*/sampler>", "", SCENE))
    refused(message, "compare", tmp_path / "little.xml", *arguments, "-m", "llvm_ad_rgb")


def test_flip_is_1_between_extremes():
    green, blue = (np.broadcast_to(np.eye(3)[c], (32, 32, 3)).astype(float) for c in (1, 2))
    # The largest colour difference that the metric knows (Andersson et al. 2020): green to blue.
    assert mean_flip(green, blue) == pytest.approx(1, abs=0.02)
    assert mean_flip(green, 0.9 * green) < 0.5


def test_equal_cost_is_that_of_the_measured_seeds():
    """The samples and the time of A differ from seed to seed; those of B here are both its samples per pixel."""

    def method(cost):
        return SimpleNamespace(render=lambda seed: (None, np.array(cost(seed)), 0.0, cost(seed)), cost=cost)

    settings = SimpleNamespace(rounds=5, b=None, at=lambda spp, spec: method(lambda seed: spp))
    found = comparison.Comparison.equal_cost_methods(settings, method(lambda seed: [99, 4, 8, 300, 6, 200][seed]))
    assert [one.cost(0) for one in found.values()] == [8, 8]
