"""``prosim compare``: its measures against known values, its page against its own figures."""

import html.parser
import importlib.util
import json
import re

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from mitsuba_prosim.cli import compare_command as compare
from mitsuba_prosim.cli import progress
from mitsuba_prosim.cli.option_types import InputError
from mitsuba_prosim.compare import measures, runs
from mitsuba_prosim.compare.contestants import Scene, Spec
from mitsuba_prosim.scene.scene_file import SceneFile
from prosim_start.group import prosim

#: Whether the package that denoises is there: the page has its rows then.
DENOISES = importlib.util.find_spec("mitsuba_oidn") is not None


SCENE = """<scene version="3.0.0">
    <integrator type="prosim">
        <integer name="samples" value="3"/>
        <rgb name="ambient" value="0.1, 0.1, 0.1"/>
        <rgb name="background" value="0.2, 0.3, 0.5"/>
    </integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 2, 6" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="16"/><integer name="height" value="12"/><rfilter type="box"/>
        </film>
        <sampler type="independent"/>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/></transform>
        <bsdf type="prosim_lambertian"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
    </shape>
    <shape type="sphere">
        <point name="center" x="0" y="1" z="0"/>
        <bsdf type="prosim_conductor"><string name="material" value="Cu"/><float name="alpha" value="0.2"/></bsdf>
    </shape>
    <shape type="sphere">
        <point name="center" x="-3" y="4" z="3"/><float name="radius" value="0.5"/>
        <emitter type="area"><rgb name="radiance" value="30, 30, 30"/></emitter>
    </shape>
</scene>
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """(page, facts, folder) of a comparison at tiny size."""
    folder = tmp_path_factory.mktemp("compare")
    (folder / "little.xml").write_text(SCENE)
    arguments = ["prosim", "path:multijitter", "--rounds", "2", "--levels", "2,3", "--exposure", "-1"]
    arguments += ["--reference-seconds", "0", "--cache", str(folder / "cache"), "-m", "llvm_ad_rgb"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "SHORTEST", 0)
        patch.setattr(progress, "SHARE", 0)
        command = ["compare", str(folder / "little.xml"), *arguments, *(["--denoise"] if DENOISES else [])]
        result = CliRunner().invoke(prosim, command)
    assert result.exit_code == 0, result.output
    assert "reference of all paths: " in result.stderr and "rendering in turn: " in result.stderr
    stem = folder / "little-compare"
    return (
        stem.with_suffix(".html").read_text(encoding="utf-8"),
        json.loads(stem.with_suffix(".json").read_text()),
        folder,
    )


class Page(html.parser.HTMLParser):
    """The numbers in <data>, the text outside of it, and what the page refers to."""

    def __init__(self, text):
        super().__init__()
        self.numbers, self.words, self.references, self.inside = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in ("meta", "img"):
            self.inside.append(tag)
        if tag == "data":
            self.numbers.append(attributes["value"])
        self.references += [attributes[name] for name in ("src", "href") if name in attributes]

    def handle_endtag(self, tag):
        assert self.inside.pop() == tag

    def handle_data(self, data):
        if not {"data", "style", "script"} & set(self.inside):
            self.words.append(data)


def leaves(facts):
    """All texts and numbers in a tree of dictionaries and lists."""
    if isinstance(facts, (dict, list)):
        for value in facts.values() if isinstance(facts, dict) else facts:
            yield from leaves(value)
    else:
        yield facts


# ---- measures


def test_measures_of_a_known_error():
    reference = np.full((16, 16, 3), 0.25)
    image = reference.copy()
    image[:, :8] = 0.36
    assert measures.rmse(image, reference) == pytest.approx(0.11 / np.sqrt(2))
    assert measures.tone_mapped_rmse(image, reference) == pytest.approx(0.1 / np.sqrt(2))
    assert measures.percentile99(image, reference) == pytest.approx(0.1)
    assert measures.relative_mse(image, reference) == pytest.approx(0.11**2 / 2 / (0.25**2 + 0.01))


def test_measures_of_equal_images_and_order_of_unequal_ones():
    rng = np.random.default_rng(1)
    reference = rng.random((32, 32, 3))
    noise = rng.normal(size=reference.shape)
    for name, measure in measures.ALL.items():
        equal, near, far = (measure(reference + s * noise, reference) for s in (0, 0.05, 0.3))
        assert equal == pytest.approx(1 if name == "ssim" else 0, abs=1e-6), name
        assert (far < near < equal) if name == "ssim" else (far > near > equal), name


def test_slope_and_equal_error():
    costs = np.array([1.0, 4, 16])
    assert measures.slope(costs, 3 / costs) == pytest.approx(-1)
    assert measures.cost_at(1.0, costs, 3 / costs) == pytest.approx(3)
    assert measures.cost_at(0.1, costs, 3 / costs) is None
    assert measures.cost_at(4.0, costs, 3 / costs) is None


# ---- runs


def converged(folder, key, estimators, seconds=0.0):
    reference = runs.Reference(folder, key, estimators)
    assert list(reference.converge(seconds))[-1:] in ([], [1.0])
    return reference


def test_contestants_in_words():
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
    scene = Scene(SceneFile(path, tmp_path))
    mi.set_log_level(mi.LogLevel.Error)
    assert scene.contestant(Spec("path:ldsampler"), "paths", spp=25).counts().mean() == 64
    assert scene.contestant(Spec("path:orthogonal"), "paths", spp=64).counts().mean() == 121
    counts = scene.contestant(Spec("prosim"), "scene").counts()
    assert counts.shape == (12, 16)
    assert set(np.unique(counts)) == {3, 9}
    for transport in ("paths", "direct"):
        integrator = {"paths": "path", "direct": "direct"}[transport]
        pair = [
            scene.contestant(Spec("prosim,adaptive=none,samples=10"), transport),
            scene.contestant(Spec(integrator + ":multijitter"), transport, spp=100),
        ]
        reference = converged(tmp_path, transport, pair)
        assert 0.6 < reference.disagreement < 1.5


def test_references_are_kept_and_continued(tmp_path, variant_rgb):
    class Noise:
        calls = 0

        def render(self, seed):
            Noise.calls += 1
            return np.random.default_rng(seed).normal(1, 0.1, (32, 32, 3)), 0, 0

    first = converged(tmp_path, "key", [Noise()])
    again = converged(tmp_path, "key", [Noise()])
    assert Noise.calls == 3
    assert np.array_equal(first.image, again.image)
    assert first.error == pytest.approx(0.1 / np.sqrt(3), rel=0.05)
    longer = converged(tmp_path, "key", [Noise()], first.seconds + 0.02)
    assert longer.passes > 3
    assert longer.error < first.error


def test_a_reference_is_of_one_content_and_one_version(tmp_path, variant_rgb, monkeypatch):
    """What a scene includes counts as its own text does, and so does whatever renders it."""
    head, body, tail = SCENE.partition('<shape type="sphere">')
    (tmp_path / "balls.xml").write_text('<scene version="3.0.0">' + body + tail)
    (tmp_path / "scene.xml").write_text(head + '<include filename="balls.xml"/></scene>')

    def key():
        return Scene(SceneFile(tmp_path / "scene.xml", tmp_path)).key

    first = key()
    assert key() == first
    monkeypatch.setattr("mitsuba_prosim.engine.origin.__version__", "0.0")
    assert key() != first
    monkeypatch.undo()
    (tmp_path / "balls.xml").write_text('<scene version="3.0.0">' + body + tail.replace("30, 30, 30", "20, 20, 20"))
    assert key() != first


def test_references_that_can_not_be_stored(tmp_path):
    """An error before they are rendered."""
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"references can't be stored: .*Not a directory"):
        compare.check_cache(tmp_path / "file" / "cache", 10)
    compare.check_cache(tmp_path / "cache", 10)


# ---- the page


@pytest.mark.slow
def test_page_holds_what_it_must(report):
    page, facts, _ = report
    same, own = facts["sections"]
    assert same["transport"] == "paths"
    assert own["transport"] == "scene"
    roles = ["a", "b at equal samples", "b at equal time"]
    assert [row["role"] for row in same["rows"]] == roles + DENOISES * [f"{role} denoised" for role in roles]
    if DENOISES:
        halves = [row["samples"] for row in same["rows"][3:]]
        assert 0 < halves[0] <= 8 and halves[1] == pytest.approx(same["rows"][1]["samples"], abs=4)  # samplers round
        assert "equal samples, denoised" in page
    assert same["rows"][1]["samples"] == pytest.approx(same["rows"][0]["samples"], abs=2)
    headings = "RMSE,relMSE,SSIM,ꟻLIP,Error against samples and time,equal samples,equal time,caustics,slope"
    assert all(heading in page for heading in headings.split(","))
    assert (
        page.count("<figure")
        == page.count("data:image/png")
        == (1 + 3 * 4 * (1 + DENOISES)) + (1 + 4 * (1 + DENOISES)) + 5
    )
    assert facts["difference"]["ambient_mean"] > 0


@pytest.mark.slow
def test_every_number_on_the_page_is_in_the_json(report):
    page, facts, _ = report
    known = {repr(leaf) for leaf in leaves(facts)}
    parsed = Page(page)
    assert len(parsed.numbers) > 100
    assert [n for n in parsed.numbers if n not in known] == []
    # Digits elsewhere belong to texts of the JSON (names, versions) or to names of parameters and measures.
    text = " ".join(parsed.words)
    known_texts = {v for v in leaves(facts) if isinstance(v, str) and re.search(r"\d", v)}
    for words in (
        *sorted(known_texts, key=len, reverse=True),
        "max_level = 0",
        "diffuse_bounces = -1",
        "99th percentile",
        "plus 0.01",
        "1 is equal",
        "0 is none",
    ):
        text = text.replace(words, "")
    assert re.findall(r".{0,20}\d.{0,20}", text) == []


@pytest.mark.slow
def test_page_needs_no_network(report):
    references = Page(report[0]).references
    assert references
    assert all(r.startswith(("data:image/", "#")) for r in references)
    assert "url(" not in report[0]
    assert "@import" not in report[0]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["nosuchintegrator"], '"nosuchintegrator" not found!'),
        (["pth"], '"pth" not found! Did you mean path?'),
        (["prosim", "path:multijiter"], "'path:multijiter': failed to instantiate"),
        (["prosim", "path,max_dept=4"], '"max_dept"'),
        (["prosim,adaptiv=none"], '"adaptiv"'),
        (["prosim,samples=-1"], "samples"),
        (["prosim,samples"], "PARAMETER=VALUE"),
        (["prosim", "path", "--resolution", "5x5"], "SSIM needs 7 x 7"),
    ],
)
def test_wrong_input_writes_nothing(tmp_path, arguments, message):
    (tmp_path / "little.xml").write_text(SCENE)
    result = CliRunner().invoke(prosim, ["compare", str(tmp_path / "little.xml"), *arguments, "-m", "llvm_ad_rgb"])
    assert result.exit_code == 2
    assert message in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["little.xml"]


def test_flip_is_1_between_extremes():
    green, blue = (np.broadcast_to(np.eye(3)[c], (32, 32, 3)).astype(float) for c in (1, 2))
    # The largest colour difference that the metric knows (Andersson et al. 2020): green to blue.
    assert measures.flip(green, blue) == pytest.approx(1, abs=0.02)
    assert measures.flip(green, 0.9 * green) < 0.5
