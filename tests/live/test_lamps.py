"""``prosim watch --layers``: layers and lamps on the page."""

import json
import urllib.error
import urllib.request

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from little import BROWSER, LITTLE, until, watching
from prosim_start import group

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lamps(tmp_path_factory):
    path = tmp_path_factory.mktemp("lamps") / "little.scn"
    path.write_text(LITTLE)
    with watching(path, "--layers", "lights") as (_, address):
        until(lambda: state(address)["status"] == "done")
        yield address


def get(address, path):
    with urllib.request.urlopen(address + path, timeout=60) as answer:
        return answer.read(), answer.headers


def state(address):
    with urllib.request.urlopen(address + "events", timeout=60) as answer:
        return json.loads(answer.readline().removeprefix(b"data: "))


def image(address, layer, query=""):
    content, facts = get(address, f"layer/own/{layer}{query}")
    shape = int(facts["X-Height"]), int(facts["X-Width"]), 3
    return np.frombuffer(content, "<f4").reshape(shape)


def channels(path):
    values = mi.Bitmap(str(path))
    names = [field.name for field in values.struct_()]
    return dict(zip(names, np.moveaxis(np.array(values, dtype=np.float32), 2, 0)))


def test_lamps_are_mixed_as_by_the_command(lamps, variant_rgb, tmp_path):
    lights = [name for name in state(lamps)["layers"] if "." in name]
    assert len(lights) == 3 and {"lights.background", "lights.ambient"} < set(lights)
    lamp = next(name.partition(".")[2] for name in lights if name not in ("lights.background", "lights.ambient"))
    assert image(lamps, "final") == pytest.approx(sum(image(lamps, name) for name in lights), abs=1e-2)
    (tmp_path / "whole.exr").write_bytes(get(lamps, "save/exr")[0])
    factors = [f"{lamp}=0.5", "ambient=2,0,1"]
    mixed = CliRunner().invoke(group.prosim, ["mix", str(tmp_path / "whole.exr"), *factors])
    assert mixed.exit_code == 0, mixed.output
    expected = channels(tmp_path / "whole-mix.exr")
    query = "?" + "&".join(f"mix=lights.{factor.replace('=', '%3D')}" for factor in factors)
    shown = image(lamps, "final", query)
    assert shown == pytest.approx(np.stack([expected[c] for c in "RGB"], axis=2), rel=5e-3, abs=1e-3)
    assert np.abs(shown - image(lamps, "final")).max() > 0.1
    (tmp_path / "saved.exr").write_bytes(get(lamps, f"save/exr{query}")[0])
    saved = channels(tmp_path / "saved.exr")
    assert all(saved[name] == pytest.approx(expected[name], rel=5e-3, abs=1e-3) for name in ("R", "B", f"{lamp}.G"))
    assert mi.Bitmap(str(tmp_path / "saved.exr")).metadata()["prosim.mix"] == f"{lamp} x 0.5, ambient x 2.0 0.0 1.0"


@pytest.mark.parametrize(
    "text",
    ["lights.lamp7=1", "final=1", *(f"lights.ambient={value}" for value in ("", "x", "nan", "1,2", "-1", "1e99"))],
)
def test_wrong_factors(lamps, text):
    for path in ("layer/own/final", "save/exr"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            get(lamps, f"{path}?mix={text.replace('=', '%3D')}")
        assert refused.value.code == 400


@pytest.mark.browser
@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on this machine")
def test_sliders(lamps, browser):
    page = browser.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(lamps)
    lamp = next(name for name in state(lamps)["layers"] if name.startswith("lights.l"))

    def values():
        return np.array(
            page.evaluate("""() => { const c = document.getElementById("own");
            return [...c.getContext("2d").getImageData(0, 0, c.width, c.height).data]; }""")
        ).reshape(-1, 4)[:, :3]

    until(lambda: page.locator("#lamps input").count() == 6 and values().max() > 100)
    before = values()
    for name in ("background", "ambient"):
        page.fill(f"input[name='lights.{name}']", "0")
    until(lambda: values().max(axis=1).min() == 0)
    page.fill(f"input[id='colour {lamp}']", "#ff0000")
    until(lambda: values()[:, 1:].max() == 0 < values()[:, 0].max())
    assert "mix=" in page.get_attribute("#exr", "href")
    for name in ("background", "ambient"):
        page.fill(f"input[name='lights.{name}']", "1")
    page.fill(f"input[id='colour {lamp}']", "#ffffff")
    until(lambda: np.array_equal(values(), before))
    page.check("input[value='lights.background']", force=True)
    until(lambda: page.get_attribute("#own", "data-layer") == "lights.background")
    page.close()
    assert said == []
