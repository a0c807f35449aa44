"""The page, driven in a browser."""

import re
import signal

import mitsuba as mi
import numpy as np
import pytest
from little import BROWSER, LITTLE, new_page, opened, shown, watching
from scenes import read_exr
from waiting import until

pytestmark = [pytest.mark.browser, pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome in PATH")]

LONG = LITTLE.replace("NSAMPLES: 2", "NSAMPLES: 150")


@pytest.fixture
def page(browser, address):
    with opened(browser, address, viewport={"width": 1400, "height": 900}) as page:
        is_(page, "done")
        yield page


def is_(page, doing):
    """Waits until it is, and the newest picture is there to be seen."""
    page.wait_for_selector(f"body[data-status={doing}]")
    until(lambda: page.get_attribute("#canvas", "data-number") == page.get_attribute("body", "data-newest"))


def decoded(content):
    """The pixels of an image file."""
    stream = mi.MemoryStream()
    stream.write(content)
    stream.seek(0)
    return np.array(mi.Bitmap(stream)).astype(int)


def box(page):
    """Where the picture is."""
    return page.locator("#picture").bounding_box()


def press(page, key, on="#stage"):
    page.focus(on)
    page.keyboard.press(key)


def drag(page, start, end):
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end)
    page.mouse.up()


def save(page, scene, text, doing="done"):
    """Saves as many editors do, by a new file that is renamed; waits until it is seen."""
    before = page.get_attribute("#canvas", "data-number")
    (new := scene.with_name("little.scn.new")).write_text(text)
    new.replace(scene)
    if doing != "failed":
        until(lambda: page.get_attribute("#canvas", "data-number") != before)
    is_(page, doing)
    until(lambda: page.evaluate("document.getElementById('canvas').width") == 64)


def test_page_shows_the_saved_image(page, address):
    for stops in ("0", "-1"):
        page.fill("#exposure", stops)
        png = page.request.get(f"{address}save/png?exposure={stops}").body()
        assert np.abs(shown(page) - decoded(png)).max() <= 1
    page.click("#neutral")
    assert page.input_value("#exposure") == "0" and page.is_disabled("#neutral")
    with page.expect_download() as download:
        page.click("#exr")
    assert download.value.suggested_filename == "little.exr"
    exr = read_exr(download.value.path())
    assert {"R", "G", "B", "error.Y", "samples.Y"} <= {field.name for field in exr.struct_()}
    assert exr.metadata()["prosim.scene"].endswith("little.scn")


def test_page_shows_values_and_keys_change_layers_and_zoom(page):
    page.mouse.move(500, 400)
    until(lambda: "little.scn, line 8 (SURFACE 0 of SPHERE 0)" in page.inner_text("#pixel"))
    assert re.search(r"\(\d+, \d+\) · RGB( [\d.]+){3} · error [\d.e-]+ · \d samples", page.inner_text("#pixel"))
    picture = shown(page)
    press(page, "ArrowRight", "input[value=final]")  # the next radio button
    until(lambda: page.get_attribute("#canvas", "data-layer") == "error")
    assert not np.array_equal(shown(page), picture)
    white = page.evaluate("async () => Number((await fetch('layer/error')).headers.get('X-White'))")
    for stops in ("2", "0"):
        page.fill("#exposure", stops)
        marks = [mark.split()[0] for mark in page.locator("#scale span").all_inner_texts()]
        ends = [white / 2 ** int(stops) * part for part in (0, 0.25, 1)]
        assert [float(mark) for mark in marks] == pytest.approx(ends, rel=0.05)
    press(page, "ArrowRight", "input[value=error]")
    until(lambda: page.get_attribute("#canvas", "data-layer") == "samples")
    assert page.locator("#scale span").all_inner_texts() == ["0", "1", "4 or more"]
    page.keyboard.press("Home")
    page.check("input[value=final]", force=True)
    until(lambda: np.array_equal(shown(page), picture))
    assert page.is_hidden("#scale")
    fitted = box(page)
    press(page, "1")
    assert box(page)["width"] == 64
    press(page, "+")
    assert box(page)["width"] == 80
    x = box(page)["x"]
    page.keyboard.press("ArrowRight")
    assert box(page)["x"] == x - 40
    page.keyboard.press("0")
    assert box(page) == fitted
    page.mouse.move(500, 400)
    page.mouse.wheel(0, -300)
    until(lambda: box(page)["width"] > fitted["width"])
    x = box(page)["x"]
    drag(page, (500, 400), (530, 400))
    assert box(page)["x"] == pytest.approx(x + 30)


def test_all_pages_show_the_saved_scene_and_its_errors(page, browser, address, scene):
    other = new_page(browser)
    other.goto(address)
    is_(other, "done")
    red = shown(page)
    # A page that nobody sees fetches nothing.
    other.evaluate("Object.defineProperty(document, 'hidden', {get: () => window.away, configurable: true})")
    other.evaluate("away = true; document.dispatchEvent(new Event('visibilitychange'))")
    save(page, scene, LITTLE.replace("kd", " " * 60 + "kkd", 1), "failed")
    assert "little.scn:8:85: unknown word 'kkd'" in page.inner_text("#error p")
    quoted, caret = page.inner_text("#error pre").splitlines()
    assert caret.index("^") == quoted.index("kkd")
    assert np.array_equal(shown(page), red)
    for width, height in ((390, 844), (1400, 900)):
        page.set_viewport_size({"width": width, "height": height})
        until(lambda width=width: box(page)["width"] <= width)
    save(page, scene, LITTLE.replace("kd = 0.6 0.2 0.1", "kd = 0.1 0.2 0.6"))
    assert page.is_hidden("#error")
    until(lambda: shown(page)[20, 30, 2] > shown(page)[20, 30, 0])
    assert np.array_equal(shown(other), red)
    other.evaluate("away = false; document.dispatchEvent(new Event('visibilitychange'))")
    until(lambda: np.array_equal(shown(other), shown(page)))
    other.close()
    blue = shown(page)
    scene.unlink()
    is_(page, "missing")
    assert "the file does not exist" in page.inner_text("#state") and page.is_hidden("#error")
    assert np.array_equal(shown(page), blue)
    dark = LITTLE.replace("600000 600000 600000", ".1 .1 .1").replace("20000 20000 20000", "0 0 0")
    save(page, scene, dark.replace("5000 6000 10000", "0 0 0"))
    assert "Exposure 1" in page.inner_text("#black")
    save(page, scene, LITTLE)
    assert page.is_hidden("#black")
    until(lambda: np.array_equal(shown(page), red))


def test_state_of_a_render_keeps_what_is_marked(page, scene):
    save(page, scene, LONG, "rendering")
    # What is marked stays so, and what changes ten times a second is not read out.
    page.evaluate("getSelection().selectAllChildren(document.getElementById('scene'))")
    state = page.inner_text("#state")
    until(lambda: page.inner_text("#state") != state)
    assert page.evaluate("String(getSelection())") == "little.scn" and page.inner_text("#announcement") == "rendering"
    save(page, scene, LITTLE)


def test_touch_shows_the_pixel(browser, address):
    with opened(browser, address, viewport={"width": 390, "height": 844}, has_touch=True) as phone:
        is_(phone, "done")
        picture = box(phone)
        phone.touchscreen.tap(picture["x"] + picture["width"] / 2 + 3, picture["y"] + picture["height"] / 2 + 3)
        until(lambda: phone.inner_text("#pixel").startswith("(32, 24) · RGB"))
        assert box(phone) == picture


def test_camera_moves(page):
    home = shown(page)
    press(page, "Space", "#camera")
    drag(page, (500, 400), (560, 430))
    until(lambda: page.is_visible("#view") and page.inner_text("#text").startswith("VIEW"))
    is_(page, "done")
    until(lambda: not np.array_equal(shown(page), home) and shown(page).shape == home.shape)
    text = page.inner_text("#text")
    press(page, "ArrowRight")
    until(lambda: page.inner_text("#text") != text)
    page.click("#home")
    assert page.evaluate("document.activeElement.id") == "stage"
    until(lambda: page.is_hidden("#view") and np.array_equal(shown(page), home))
    is_(page, "done")
    page.uncheck("#camera", force=True)


def test_page_fits_narrow_screens_and_has_contrast(page):
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for size in ((390, 844), (1400, 900)):
            page.set_viewport_size({"width": size[0], "height": size[1]})
            assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        ratios = page.evaluate(
            """() => { const light = c => { const v = c.match(/[\\d.]+/g).slice(0, 3).map(x => x / 255)
                .map(x => x <= .03928 ? x / 12.92 : ((x + .055) / 1.055) ** 2.4);
                return .2126 * v[0] + .7152 * v[1] + .0722 * v[2]; };
            const ground = e => { while (e) { const c = getComputedStyle(e).backgroundColor;
                if (!/, 0\\)$/.test(c)) return c; e = e.parentElement; } return "rgb(255,255,255)"; };
            return [...document.querySelectorAll("h1, #state, #pixel, button, .button, .group span, .slider, #error")]
                .map(e => [light(getComputedStyle(e).color), light(ground(e))])
                .map(([a, b]) => (Math.max(a, b) + .05) / (Math.min(a, b) + .05)); }"""
        )
        assert len(ratios) > 10 and min(ratios) >= 4.5


def test_buttons_vanish_when_the_render_ends(browser, write_scene):
    page = new_page(browser)
    with watching(write_scene(LITTLE, "café 1.scn")) as (process, address):
        page.goto(address)
        is_(page, "done")
        picture = shown(page)
        with page.expect_download() as download:
            page.click("#png")
        assert download.value.suggested_filename == "café 1.png"
        process.send_signal(signal.SIGINT)
        is_(page, "lost")
    assert "has ended" in page.inner_text("#state") and np.array_equal(shown(page), picture)
    assert all(page.is_disabled(f"#{name}") for name in ("camera", "home"))
    assert all(page.get_attribute(f"#{name}", "href") is None for name in ("exr", "png"))
    assert page.is_disabled("input[value=error]")
    page.close()


def test_click_opens_the_page_that_explains_the_pixel(page, address):
    """The page runs only its own script, and asks nobody anything; a drag opens nothing."""
    page.check("#explain", force=True)
    drag(page, (500, 400), (560, 400))
    shown_at = box(page)
    with page.expect_popup() as popup:
        page.mouse.click(shown_at["x"] + 20.5 / 64 * shown_at["width"], shown_at["y"] + 26.5 / 48 * shown_at["height"])
    explained, said = popup.value, []
    explained.wait_for_load_state()  # a page that is still opening can't be reloaded
    explained.on("console", lambda message: said.append(message.text))
    explained.on("request", lambda request: said.append(request.url))
    explained.reload()
    until(lambda: explained.text_content("h1") == "Pixel 20, 26 of little.scn")
    until(lambda: explained.locator("#frame img").evaluate("image => image.naturalWidth") == 64)
    assert explained.locator("#tree [role=button]").count() >= 1 and len(page.context.pages) == 2
    assert said == [f"{address}explain/20/26"]
    explained.close()
    page.focus("#stage")
    with page.expect_popup() as popup:
        page.keyboard.press("Enter")
    assert popup.value.url.startswith(f"{address}explain/")
    popup.value.close()
