"""``prosim watch --layers``: layers and lamps on the page."""

import numpy as np
import pytest
from click.testing import CliRunner
from little import BROWSER, LITTLE, ask, opened, shown, state_when, watching
from prosim_start import group
from scenes import channels, read_exr
from waiting import until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lamps(tmp_path_factory):
    """Address of the page, names of the layers of lights, and the scene."""
    path = tmp_path_factory.mktemp("lamps") / "little.scn"
    path.write_text(LITTLE)
    with watching(path, "--layers", "lights") as (_, address):
        names = [name for name in state_when(address, "done")["layers"] if "." in name]
        yield address, names, path


def image(address, layer, query=""):
    answer, content = ask(address, f"layer/{layer}{query}")
    shape = int(answer.getheader("X-Height")), int(answer.getheader("X-Width")), 3
    return np.frombuffer(content, "<f4").reshape(shape)


def test_lamps_are_mixed_as_by_the_command(lamps, variant_rgb, tmp_path):
    address, lights, _ = lamps
    assert len(lights) == 3 and {"lights.background", "lights.ambient"} < set(lights)
    lamp = next(name.partition(".")[2] for name in lights if name not in ("lights.background", "lights.ambient"))
    assert image(address, "final") == pytest.approx(sum(image(address, name) for name in lights), abs=1e-2)
    (tmp_path / "whole.exr").write_bytes(ask(address, "save/exr")[1])
    factors = [f"{lamp}=0.5", "ambient=2,0,1"]
    mixed = CliRunner().invoke(group.prosim, ["mix", str(tmp_path / "whole.exr"), *factors])
    assert mixed.exit_code == 0, mixed.output
    expected = channels(tmp_path / "whole-mix.exr")
    query = "?" + "&".join(f"mix=lights.{factor.replace('=', '%3D')}" for factor in factors)
    seen = image(address, "final", query)
    assert seen == pytest.approx(np.stack([expected[c] for c in "RGB"], axis=2), rel=5e-3, abs=1e-3)
    assert np.abs(seen - image(address, "final")).max() > 0.1
    (tmp_path / "saved.exr").write_bytes(ask(address, f"save/exr{query}")[1])
    saved = channels(tmp_path / "saved.exr")
    assert all(saved[name] == pytest.approx(expected[name], rel=5e-3, abs=1e-3) for name in ("R", "B", f"{lamp}.G"))
    assert read_exr(tmp_path / "saved.exr").metadata()["prosim.mix"] == f"{lamp} x 0.5, ambient x 2.0 0.0 1.0"


def test_server_refuses_wrong_factors(lamps):
    values = "", "x", "nan", "1,2", "-1", "1e17"
    for text in ("lights.lamp7=1", "final=1", *(f"lights.ambient={value}" for value in values)):
        for path in ("layer/final", "save/exr"):
            assert ask(lamps[0], f"{path}?mix={text.replace('=', '%3D')}")[0].status == 400, text


def page_factors(page):
    return [float(slider.input_value()) for slider in page.locator("#lamps input[type=range]").all()]


@pytest.mark.browser
@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome in PATH")
def test_sliders_mix_the_lamps(lamps, browser):
    address, lights, path = lamps
    lamp = next(name for name in lights if name.startswith("lights.l"))
    with opened(browser, address) as page:
        until(lambda: page.locator("#lamps input").count() == 6 and shown(page).max() > 100)
        before = shown(page)
        for name in ("background", "ambient"):
            page.fill(f"input[name='lights.{name}']", "0")
        until(lambda: shown(page).max(axis=2).min() == 0)
        page.fill(f"input[id='colour {lamp}']", "#ff0000")
        until(lambda: shown(page)[..., 1:].max() == 0 < shown(page)[..., 0].max())
        assert "mix=" in page.get_attribute("#exr", "href")
        assert page.locator("#lamps output").all_inner_texts() == [f"{n:.2f}" for n in page_factors(page)]
        short = lamp.partition(".")[2]
        labels = page.locator("#lamps label").all_inner_texts()
        assert sorted(labels) == ["ambient", "background", f"{short}: AREA (line 4)"]
        command = page.inner_text("#command").split()
        assert command[:3] == ["prosim", "mix", "little.exr"] and {f"{short}=1,0,0", "ambient=0"} < set(command)
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.click("#copy-command")
        until(lambda: page.evaluate("navigator.clipboard.readText()").split() == command)
        assert page.inner_text("#announcement") == "Copied"
        page.click("#unmix")
        assert page.is_hidden("#mixed") and set(page_factors(page)) == {1}
        until(lambda: np.array_equal(shown(page), before))
        page.check("input[value='lights.background']", force=True)
        until(lambda: page.get_attribute("#canvas", "data-layer") == "lights.background")
        path.write_text(f"# a line more\n{LITTLE}")
        until(lambda: f"{short}: AREA (line 5)" in page.locator("#lamps label").all_inner_texts())
        assert page.get_attribute("#canvas", "data-layer") == "lights.background"
