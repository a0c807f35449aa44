"""The page that explains a pixel, driven in a browser."""

import mitsuba as mi
import pytest
from little import BROWSER, LITTLE, opened
from mitsuba_prosim.explaining import explanation
from mitsuba_prosim.scene.scene_file import SceneFile

pytestmark = [pytest.mark.browser, pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome in PATH")]
MIRROR = LITTLE.replace("lambertiano kd = 0.4 0.5 0.6", "composto kd = 0.2 0.2 0.2 n-refr = 1.6")


@pytest.fixture(scope="module", params=[(48, 1200, "light"), (30, 390, "dark")], ids=["perspective", "window"])
def file(request, tmp_path_factory):
    """The page of a pixel whose rays are reflected, and how it is shown; of square pixels, and of others, which another
    sensor samples.
    """
    height, *how = request.param
    mi.set_variant("llvm_ad_rgb")
    folder = tmp_path_factory.mktemp("explained")
    scene = folder / "little.scn"
    scene.write_text(MIRROR)
    file = SceneFile(scene, folder, resolution=(64, height))
    page = folder / "page.html"
    page.write_text(explanation.page(file, command="prosim explain", pixel=(20, 26), spp=16), "utf-8")
    return page, *how


@pytest.fixture
def page(browser, file):
    path, width, scheme = file
    with opened(browser, f"file://{path}", viewport={"width": width, "height": 800}, color_scheme=scheme) as page:
        yield page


def test_page_fits_and_says_what_it_shows(page):
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.text_content("h1") == "Pixel 20, 26 of little.scn"
    assert page.text_content("#command") == "prosim explain" and " pixels" in page.text_content("#sum")
    assert page.evaluate("Math.min(...[...document.querySelectorAll('#list button')].map(b => b.offsetHeight))") >= 44
    assert "of 16 samples make 90 %" in page.text_content("#error")
    assert page.text_content("#sample").endswith(" % of the squared error")
    # The image comes before the sentences, and fits into the first screen.
    bottom, light = page.evaluate("['frame', 'light'].map(id => find(id).getBoundingClientRect().bottom)")
    assert bottom < 800 and bottom < light
    assert page.get_attribute("#tree [aria-pressed=true]", "data-number") == page.text_content("#node td").split(",")[0]
    page.focus("#tree [data-number='1']")
    page.keyboard.press("Enter")
    names = page.evaluate("data.patterns.filter(([number]) => number === 1).map(([, name]) => name)")
    assert page.locator("#patterns figcaption").all_text_contents() == names and "pixel" in names
    assert page.locator("#patterns [fill=none]").count() == len(names)  # the ring of the sample
    page.emulate_media(media="print")
    assert page.is_visible("#error") and page.is_hidden("#list")  # a click on paper does nothing


def test_first_point_is_projected_into_the_pixel(page):
    for number in range(page.evaluate("data.trees.length")):
        x, y = page.evaluate(f"project(data.trees[{number}].nodes[0].position)")
        assert 20 - 1e-3 <= x <= 21 + 1e-3 and 26 - 1e-3 <= y <= 27 + 1e-3


def test_keyboard_chooses_samples_and_nodes(page):
    other = page.evaluate("data.trees[2].sample")
    button = page.locator("#list button", has_text=f"sample {other}:")
    button.focus()
    page.keyboard.press("Enter")
    assert page.text_content("#sample").startswith(f"sample {other}: ") and page.text_content("#list :focus")
    # A choice scrolls to the tree.
    assert page.evaluate("find('tree').getBoundingClientRect().bottom <= innerHeight + 1")
    assert page.locator("#tree [role=button]").count() == page.evaluate("tree.nodes.length") > 1
    page.locator("#tree [role=button]").last.focus()
    page.keyboard.press("Space")
    number = page.locator("#tree [role=button]").last.get_attribute("data-number")  # as in Python
    last = page.evaluate(f"tree.nodes.find(node => node.number === {number})")
    assert page.text_content("#node td").startswith("{number}, from node {parent}, level {level}".format(**last))


def test_view_from_outside_turns_by_mouse_and_keys(page):
    shown = "find('outside').toDataURL()"
    before = page.evaluate(shown)
    page.focus("#outside")
    page.keyboard.press("ArrowLeft")
    turned = page.evaluate(shown)
    box = page.locator("#outside").bounding_box()
    page.mouse.move(box["x"] + 50, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 90, box["y"] + 80)
    page.mouse.up()
    assert before != turned != page.evaluate(shown)
