"""A confined scene can name no file outside its folder: each way to one is refused before a file is opened."""

import html
import random
import re
from pathlib import Path

import mitsuba as mi
import pytest
from mitsuba_prosim.compat import LIBRARIES
from mitsuba_prosim.scene import session
from mitsuba_prosim.scene.confinement import OutsideError, named
from mitsuba_prosim.scene.scene_file import SceneFile

INCLUDE, DEFAULT = '<include filename="{}"/>', '<default name="{}" value="{}"/>'
SPECTRUM = '<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>'
STRING = '<shape type="ply">\n  <string name="filename" value="{}"/></shape>'
METAL = '<bsdf type="conductor"><string name="material" value="{}"/></bsdf>'
HERE = '<scene version="3.0.0">\n{}</scene>'

#: What a scene names, with OUT for the absolute path of the folder around its own, where the command is given.
OUTSIDE = {
    **{
        f"{path}{end}": form.format(f"{path}{end}")
        for end, form in ((".xml", INCLUDE), (".spd", SPECTRUM), (".ply", STRING))
        for path in ("../secret", "OUT/secret", "secret", "link")
    },
    "included in a detour": INCLUDE.format("parts/../../secret.xml"),
    "included by a link of a folder": INCLUDE.format("up/secret.xml"),
    "included by what is included": INCLUDE.format("parts/above.xml"),
    "a device": INCLUDE.format("/dev/zero"),
    "written in characters' numbers": INCLUDE.format("&#x2e;&#46;/secret.xml"),
    "behind CDATA and comments": "<!-- <![CDATA[ -->" + INCLUDE.format("../secret.xml") + "<!-- ]]> -->",
    "a folder to search": '<path value=".."/>' + INCLUDE.format("secret.xml"),
    "a folder to search by its path": '<path value="OUT"/>',
    "a parameter": DEFAULT.format("x", "..") + INCLUDE.format("$x/secret.xml"),
    "a folder to search, a link": '<path value="up"/>',
    "parameters that begin alike": DEFAULT.format("x", "a")
    + DEFAULT.format("xx", "..")
    + INCLUDE.format("$xx/secret.xml"),
    "a parameter in a parameter": DEFAULT.format("xx", r"\$y")
    + DEFAULT.format("y", "..")
    + INCLUDE.format("$xx/secret.xml"),
    "a parameter of the command": INCLUDE.format("$x.xml"),
    "a parameter of what is included": INCLUDE.format("parts/default.xml") + INCLUDE.format("$up/secret.xml"),
    "a mesh that is not there": STRING.format("../none.ply"),
    "a metal": METAL.format("../../../secret"),
    "a metal by a link": METAL.format("link"),
    "a name that no plugin here has": '<shape type="sphere"><string name="picture" value="../secret.ply"/></shape>',
    "a plugin": '<shape type="../../secret"/>',
    "a plugin from the folder where the command is given": '<shape type="secret"/>',
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a scene in another, which has secrets, and where the command is given."""
    folder = tmp_path / "scene"
    for name in ("parts", "data/ior"):
        (folder / name).mkdir(parents=True)
    for end in (".xml", ".spd", ".ply"):
        (tmp_path / f"secret{end}").write_text("SECRET 1")
        (folder / f"link{end}").symlink_to(tmp_path / f"secret{end}")
        (folder / f"good{end}").write_text(
            "400 1\n700 1" if end == ".spd" else HERE.format('<emitter type="constant"/>')
        )
    (tmp_path / "plugins").mkdir()
    for end in LIBRARIES:
        (tmp_path / "plugins" / f"secret{end}").write_text("SECRET")
    (folder / "up").symlink_to(tmp_path)
    (folder / "data" / "ior" / "link.eta.spd").symlink_to(tmp_path / "secret.spd")
    (folder / "parts" / "above.xml").write_text(HERE.format(INCLUDE.format("../../secret.xml")))
    (folder / "parts" / "default.xml").write_text(HERE.format('<default name="up" value=".."/>'))
    (folder / "parts" / "beside.xml").write_text(HERE.format(INCLUDE.format("../good.xml")))
    monkeypatch.chdir(tmp_path)
    with session.search_path([tmp_path]):  # Mitsuba prepends the folder in which it is imported
        yield folder


def opened(folder, text, confined=True, **definitions):
    path = folder / "scene.xml"
    path.write_bytes(text if isinstance(text, bytes) else HERE.format(text).encode())
    return SceneFile(path, folder, definitions=definitions, confined=confined)


@pytest.mark.parametrize("way", OUTSIDE)
def test_files_outside_are_refused(variant_rgb, folder, way):
    text = OUTSIDE[way].replace("OUT", str(folder.parent))
    with pytest.raises(OutsideError, match=r"^At .*\.xml \(line \d, col \d+\): ") as error:
        opened(folder, text, **({"x": str(folder.parent / "secret")} if "$x.xml" in text else {}))
    words = str(error.value)
    assert "SECRET" not in words and "--allow-outside" in words


def test_files_within_and_those_of_mitsuba_are_read(variant_rgb, folder):
    """As without a confinement; what is not there is missed by Mitsuba, in its own words."""
    (folder.parent / "rgb").mkdir()  # a word of Mitsuba's, where the command is given
    (folder / "again.ply").symlink_to(folder / "good.ply")
    film = '<film type="hdrfilm"><string name="pixel_format" value="rgb"/></film>'
    for text in (
        *(SPECTRUM.format(name) for name in ("good.spd", "data/ior/Cu.eta.spd")),
        *(STRING.format(name) for name in ("parts/../again.ply", "$x", folder / "good.ply")),
        INCLUDE.format("parts/beside.xml"),
        '<path value="parts"/>' + INCLUDE.format("default.xml") + STRING.format("$up/good.ply"),
        f'<sensor type="perspective">{film}</sensor>',
    ):
        opened(folder, text, x="good.ply") if "$x" in text else opened(folder, text)
    assert opened(folder, METAL.format("Cu")).load()
    for missing in (SPECTRUM, INCLUDE, STRING):
        with pytest.raises(RuntimeError, match=r"\w+\.cpp"):
            opened(folder, missing.format("none.ply")).load()
    for text in (STRING.format("../secret.ply"), METAL.format("link")):
        opened(folder, text, confined=False)
    opened(folder, SPECTRUM.format("good.spd").replace("good", "../scene/good"), confined=True)


#: Parts of the values of attributes, and of what surrounds the element.
QUOTES = "\"'"
VALUE = ["&amp;", "&quot;", "-->", "..", "/", ">", "<", "é", " ", "=", "filename=", "<spectrum ", "'", '"', "a"]
BETWEEN = [
    "<!-- {} -->",
    "<![CDATA[ {} ]]>",
    "<?p {} ?>",
    "{}",
    '<!-- <spectrum " -->',
    "<!-- ' -->",
    "<!DOCTYPE a '{}'>",
]


def test_every_name_that_mitsuba_opens_is_found(variant_rgb, tmp_path):
    """In random texts that Mitsuba's parser accepts up to the spectrum, which does not exist."""
    rng, path, opened_names = random.Random(1), tmp_path / "scene.xml", 0
    for _ in range(300):
        name, other = ("".join(rng.choices(VALUE, k=rng.randrange(5))) for _ in "ab")
        attributes = [f"name={(q := rng.choice(QUOTES))}{other}{q}", f"filename={(q := rng.choice(QUOTES))}Z{name}{q}"]
        before, after = (
            "".join(rng.choices(BETWEEN, k=rng.randrange(3))).replace("{}", rng.choice(VALUE)) for _ in "ab"
        )
        bsdf = f'<bsdf type="diffuse"><spectrum {" ".join(rng.sample(attributes, 2))}/></bsdf>'
        path.write_text(f'{after}<scene version="3.0.0">{before}{bsdf}</scene>')
        try:
            mi.parser.parse_file(mi.parser.ParserConfig("scalar_rgb"), str(path))
        except RuntimeError as error:
            if found := re.search('failed to load spectrum from file "(.*?)": ', str(error), re.DOTALL):
                opened_names += 1
                assert found[1] in {html.unescape(name) for _, name, _ in named(path.read_text())}
    assert opened_names > 25


@pytest.mark.parametrize(
    "text",
    [
        HERE.format("").encode("utf-16"),
        HERE.format("").encode("utf-16-le"),
        HERE.format("<!-- é -->").encode("latin-1"),
        b'<?xml version="1.0" encoding="latin1"?>' + HERE.format("<!-- é -->").encode(),
    ],
)
def test_text_in_another_encoding_is_refused(variant_rgb, folder, text):
    with pytest.raises(OutsideError, match="not in UTF-8"):
        opened(folder, text)


def test_nothing_takes_the_place_of_mitsubas_own_files(variant_rgb, folder):
    """Neither in a scene of the language. Without a confinement Mitsuba looks for them in the scene's folder first."""
    (folder / "data" / "ior" / "Cu.eta.spd").symlink_to(folder.parent / "secret.spd")
    suffix = next((Path(mi.__file__).parent / "plugins").glob("cube.*")).suffix
    (folder / "plugins").mkdir()
    (folder / "plugins" / f"cube{suffix}").symlink_to(folder.parent / "secret.xml")
    assert opened(folder, METAL.format("Cu")).load() and opened(folder, '<shape type="cube"/>').load()
    with pytest.raises(RuntimeError):
        opened(folder, METAL.format("Cu"), confined=False).load()
    scene = folder / "scene.scn"
    scene.write_text("LIGHTS POINT position 9 9 9 VIEW OBS 0 3 12 CSG-TREE SPHERE 0 SURFACE 0 TRANSFORM 0 END")
    assert SceneFile(scene, folder / "made", confined=True).load()


def test_a_text_that_is_exchanged_while_it_is_read(variant_rgb, folder, monkeypatch):
    """What Mitsuba has parsed is looked at, not what was in the file before."""
    parse = mi.parser.parse_file

    def exchanged(config, path, **parameters):
        Path(path).write_text(HERE.format(texts.pop()))
        return parse(config, path, **parameters)

    monkeypatch.setattr(mi.parser, "parse_file", exchanged)
    (folder.parent / "other.xml").write_text(HERE.format('<emitter type="constant"/>'))
    texts = [STRING.format("../secret.ply"), INCLUDE.format("../other.xml")]
    for says in ("changed while", "names"):
        with pytest.raises(OutsideError, match=says):
            opened(folder, "")
