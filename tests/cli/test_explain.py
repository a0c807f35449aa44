"""``prosim explain``: the page, and what wrong use gets."""

import json
import re
import sys

import pytest
from running import LIT_FLOOR, XML, done, refused, scene_text

PROSIM = '<integrator type="prosim"><boolean name="hide_emitters" value="true"/></integrator>'


def data_of(page):
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8"))
    return json.loads(text)


def test_page_holds_the_data_of_the_pixel(write_scene, tmp_path, monkeypatch):
    path = write_scene(scene_text(PROSIM, LIT_FLOOR, 16, 12), "<script><!--.xml")
    monkeypatch.setattr(sys, "argv", ["/bin/prosim", "explain", "a b.xml"])
    done("explain", path, "--pixel", "5,6", "--spp", "12", "-o", tmp_path / "out.html", "-m", "llvm_ad_rgb")
    data = data_of(tmp_path / "out.html")
    assert (data["name"], data["pixel"], data["size"]) == ("<script><!--.xml", [5, 6], [16, 12])
    assert data["command"] == "prosim explain 'a b.xml'"
    assert len(data["values"]) == 12 and data["trees"][0]["sample"] == data["sample"]
    assert len(data["trees"]) >= 9 and data["image"].startswith("data:image/jpeg")
    assert all(node["line"] is None for tree in data["trees"] for node in tree["nodes"])  # these shapes have no id


def test_page_is_written_beside_the_scene(write_scene):
    path = write_scene(XML, "s.xml")
    assert done("explain", path, "--pixel", "1,1", "--spp", "4", "-m", "llvm_ad_rgb").stdout.strip().endswith(".html")
    data = data_of(path.with_name("s-explain.html"))
    assert "PathIntegrator" in data["notes"][0] and data["trees"][0]["nodes"][0]["shape"] is None


def test_pixel_of_a_crop_window_is_that_of_the_image(write_scene):
    """As `prosim render --crop` names it in its last line."""
    path, values = write_scene(scene_text(PROSIM, LIT_FLOOR, 16, 12), "s.xml"), []
    for where in ["5,6"], ["1,2", "--crop", "4,4,8,8"]:
        done("explain", path, "--spp", "4", "-m", "llvm_ad_rgb", "--pixel", *where)
        values.append(data_of(path.with_name("s-explain.html"))["values"])
    assert values[0] == values[1]


def test_page_of_parallel_rays_has_the_image_without_rays(write_scene):
    path = write_scene(XML.replace("perspective", "orthographic"), "s.xml")
    done("explain", path, "--pixel", "1,1", "-m", "llvm_ad_rgb")
    data = data_of(path.with_name("s-explain.html"))
    assert data["camera"] is None and data["image"] and len(data["patterns"]) == 1


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--pixel", "12,0"], "the pixel 12,0 is outside the image, whose pixels are 0,0 to 11,7"),
        (["--pixel", "-1,0"], "is not of the form X,Y, such as 120,80"),
        ([], "Missing option '--pixel'"),
        (["--pixel", "1,1", "-m", "scalar_rgb"], "prosim explain: scalar_rgb"),
        (["--pixel", "1,1", "-o", "/proc/no/page.html"], "the result can't be written"),
        (["--pixel", "1,1", "-o", "page.exr"], "give a name or a folder for .html"),
        (["--pixel", "1,1", "-s", "1"], "sensor"),
        (["--pixel", "1,1", "--spp", "1000000"], "spp is 1000000; give a number from 1 to 16384"),
    ],
)
def test_wrong_use_is_refused_in_one_sentence(write_scene, arguments, message):
    refused(message, "explain", write_scene(XML, "s.xml"), "-m", "llvm_ad_rgb", *arguments)
