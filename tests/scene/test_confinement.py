"""A confined scene can name no file outside its folder: each way to one is refused before a file is opened."""

import os
import random
import warnings
from contextlib import suppress
from pathlib import Path

import mitsuba as mi
import prosim_scene
import pytest
from mitsuba_prosim.compat import LIBRARIES
from mitsuba_prosim.scene import session
from mitsuba_prosim.scene.confinement import MAX_DEPTH, MAX_INCLUDES, OutsideError, elements
from mitsuba_prosim.scene.scene_file import SceneFile

INCLUDE, DEFAULT = '<include filename="{}"/>', '<default name="{}" value="{}"/>'
SPECTRUM = '<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>'
STRING = '<shape type="ply">\n  <string name="filename" value="{}"/></shape>'
METAL = '<bsdf type="conductor"><string name="material" value="{}"/></bsdf>'
HERE = '<scene version="3.0.0">\n{}</scene>'
SKY = HERE.format('<emitter type="constant"/>')

XX = INCLUDE.format("$xx/secret.xml")

#: What a scene names, with OUT for the absolute path of the folder around its own.
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
    "parameters that begin alike": DEFAULT.format("x", "a") + DEFAULT.format("xx", "..") + XX,
    "a parameter in a parameter": DEFAULT.format("xx", r"\$y") + DEFAULT.format("y", "..") + XX,
    "a parameter of the command": INCLUDE.format("$x.xml"),
    "a parameter of what is included": INCLUDE.format("parts/default.xml") + INCLUDE.format("$up/secret.xml"),
    "a mesh that is not there": STRING.format("../none.ply"),
    "a mesh that is a folder": STRING.format(".."),
    "a mesh where the command is given": STRING.format(f"secret{LIBRARIES[0]}"),
    "a metal": METAL.format("../../../secret"),
    "a metal by a link": METAL.format("link"),
    "a name that no plugin here has": '<shape type="sphere"><string name="picture" value="../secret.ply"/></shape>',
    "a plugin": '<shape type="../../secret"/>',
    "a plugin from the folder where Mitsuba is imported": '<shape type="secret"/>',
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a scene in another, which has secrets, beside the folder where the command is given."""
    folder = tmp_path / "scene"
    for name in ("parts", "data/ior"):
        (folder / name).mkdir(parents=True)
    for end in (".xml", ".spd", ".ply"):
        (tmp_path / f"secret{end}").write_text("SECRET 1")
        (folder / f"link{end}").symlink_to(tmp_path / f"secret{end}")
        (folder / f"good{end}").write_text("400 1\n700 1" if end == ".spd" else SKY)
    (tmp_path / "plugins").mkdir()
    for end in LIBRARIES:
        (tmp_path / "plugins" / f"secret{end}").write_text("SECRET")
    (folder / "up").symlink_to(tmp_path)
    (folder / "data" / "ior" / "link.eta.spd").symlink_to(tmp_path / "secret.spd")
    (folder / "parts" / "above.xml").write_text(HERE.format(INCLUDE.format("../../secret.xml")))
    (folder / "parts" / "default.xml").write_text(HERE.format('<default name="up" value=".."/>'))
    (folder / "parts" / "beside.xml").write_text(HERE.format(INCLUDE.format("../good.xml")))
    monkeypatch.chdir(tmp_path / "plugins")
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
    (folder.parent / "rgb").mkdir()  # a word of Mitsuba's, where it is imported
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
    numbers = ", ".join(map(str, range(360, 830)))  # too many for a name
    lists = "".join(f'<string name="{name}" value="{numbers}"/>' for name in ("wavelengths", "values"))
    for confined in (True, False):
        text = f'<emitter type="constant"><spectrum name="radiance" type="irregular">{lists}</spectrum></emitter>'
        assert opened(folder, text, confined).load()
    for missing in (SPECTRUM, INCLUDE, STRING):
        with pytest.raises(RuntimeError, match=r"\w+\.cpp"):
            opened(folder, missing.format("none.ply")).load()
    for text in (STRING.format("../secret.ply"), METAL.format("link")):
        opened(folder, text, confined=False)
    opened(folder, SPECTRUM.format("good.spd").replace("good", "../scene/good"), confined=True)


#: What people may write around, before and in the elements of an XML scene.
BETWEEN = [
    "<!-- {} -->", "<!-- -- {} -->", "<![CDATA[ {} ]]>", "<![cdata[ {} ]]>", "<?p {} ?>", "{}", "<!-- ' -->",
    '<!-- " -->', "<!DOCTYPE a '{}'>", "<!DOCTYPE a [<!ENTITY e '{}'> <!ATTLIST string value CDATA '../d'>]>", "]]>",
    "\f", "\0", "\ufeff", "<string name='s2' value='{}'/>", "<string name='s3'\tvalue\n=\r\n'{}' />", "</scene>",
    "<string name='s4' value='{}' value='b'/>", "<string name='s5' value='{}'></string >", "<scene version='3.0.0'>",
    "<string name=s6 value='{}'/>", "<!--->", "<!-->", "<!---->", "<![CDATA[>]]>", "<string/name='s7' value='{}'/>",
    "<string name='s8' value='{}", '<default name="p" value="{}"/>', "<string name='s9'value='{}'/>",
    "<x:string name='t' value='{}'/>",
]  # fmt: skip
VALUE = [
    "&amp;", "&quot;", "-->", "..", "/", ">", "<", "é", " ", "=", "filename=", "<string ", "'", '"', "a", "\t", "\r\n",
    "\r", "&#46;", "&#x2E;", "&#4294967342;", "&#0;", "&#x;", "&#xD800;", "&e;", "&AMP;", "&#10;", "&#13;", "&amp;#46;",
    "]]>", "$p", r"\$p", "&#36;p", "&amp", "\x85", "\u2028", "OVERLONG", "HALF", "😀", "\x01", "\x7f", "\ufffe", "?>",
]  # fmt: skip
DECLARED = [
    *(f"<?xml version='1.0' encoding='{name}'?>" for name in ("UTF-8", "utf8", "latin1", "ISO-8859-1", "utf-16", "x")),
    "<?xml version='1.0' standalone='yes'?>", "<?xml version='>' encoding='latin1'?>", "<?xml version='1.1'?>", " \n",
    "<?xml encoding='latin1'?>", "<?xml version='1.0' a='>' encoding='latin1'?>", "<?XML version='1.0'?>", *[""] * 40,
]  # fmt: skip
CODECS = [*["utf-8"] * 40, "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be", "utf-7"]


def hostile(rng):
    """A document that may be XML, in some encoding."""
    pick = lambda choices: "".join(rng.choices(choices, k=rng.choice((0, 0, 1))))  # noqa: E731
    around = lambda: pick(BETWEEN).replace("{}", pick(VALUE))  # noqa: E731
    quote = rng.choice("'\"")
    text = f"{rng.choice(DECLARED)}<scene version='3.0.0'>{around()}<shape type='ply'>{around()}"
    text += f"<string name='s1' value={quote}{pick(VALUE)}{quote}/></shape>{around()}</scene>"
    content = (text + around() * (rng.random() < 0.1)).encode(rng.choice(CODECS), "replace")
    return content.replace(b"OVERLONG", b"\xc0\xae").replace(b"HALF", b"\xed\xa0\x80")


def strings_of_mitsuba(path):
    """The names and values of all strings that Mitsuba's parser reads, or None."""
    try:
        state = mi.parser.parse_file(mi.parser.ParserConfig("scalar_rgb"), str(path))
    except RuntimeError:
        return None
    text = mi.Properties.Type.String
    with suppress(UnicodeDecodeError):
        return sorted((k, p[k]) for p in (n.props for n in state.nodes) for k in p if p.type(k) == text)
    return "not in UTF-8"


def strings_of_check(content):
    """The same as the confinement reads them, or None if it refuses the document."""
    try:
        found = elements(content)
    except ValueError:
        return None
    return sorted((a.get("name"), a.get("value")) for tag, a, *_ in found if tag == "string")


def test_mitsuba_reads_each_accepted_document_alike(variant_rgb, tmp_path):
    """In 200 hostile documents; a ``$`` is left to Mitsuba."""
    rng, path, agreed, refused = random.Random(4), tmp_path / "scene.xml", 0, 0
    for _ in range(200):
        path.write_bytes(content := hostile(rng))
        theirs, ours = strings_of_mitsuba(path), strings_of_check(content)
        refused += ours is None and theirs is not None
        if ours is not None and theirs is not None and not any("$" in value for _, value in ours):
            assert ours == theirs, content
            agreed += 1
    assert agreed > 30 and refused > 10


@pytest.mark.parametrize(
    "text",
    [
        *(HERE.format("").encode(codec) for codec in ("utf-16", "utf-16-le", "utf-32", "utf-32-be")),
        HERE.format("<!-- é -->").encode("latin-1"),
        *(f"<?xml version='{v}' encoding='latin1'?>{HERE}".encode() for v in ("1.0", ">")),
        b"<!DOCTYPE scene>" + HERE.format("").encode(),
        b"<?p ?>" + HERE.format("").encode(),
        HERE.format("<!-- -- -->").encode(),
        HERE.format("\0").encode(),
        HERE.format("<bsdf type='twosided'>" * MAX_DEPTH + "</bsdf>" * MAX_DEPTH).encode(),
    ],
)  # fmt: skip
def test_text_that_parsers_may_read_differently_is_refused(variant_rgb, folder, text):
    with pytest.raises(OutsideError, match=r"^At .*scene.xml \(line \d, col \d+\): .* in UTF-8.* --allow-outside$"):
        opened(folder, text)


def test_unlimited_includes_and_pipes_are_refused(variant_rgb, folder):
    with pytest.raises(OutsideError, match=rf"\(line 2, col 2\): the scene includes more than {MAX_INCLUDES} files"):
        opened(folder, 2 * INCLUDE.format("scene.xml"))
    os.mkfifo(folder / "pipe.xml")
    for form in (INCLUDE, SPECTRUM, STRING):
        with pytest.raises(OutsideError, match="a device or a pipe"):
            opened(folder, form.format("pipe.xml"))


def test_folder_of_an_included_file_counts_for_later_names(variant_rgb, folder):
    (folder / "parts" / "good.spd").symlink_to(folder.parent / "secret.spd")
    (folder / "parts" / "adds.xml").write_text(HERE.format('<path value="parts"/>'))
    for text in (INCLUDE.format("parts/adds.xml"), '<path value="parts"/>'):
        with pytest.raises(OutsideError, match="outside the scene's folder"):
            opened(folder, text + SPECTRUM.format("good.spd"))


def test_spectrum_files_of_lax_xml_are_known_or_warned_of(variant_rgb, folder):
    """Without a confinement, Mitsuba's parser accepts more than XML."""
    for before in ("<!-- -- -->", ""):
        file = opened(folder, before + SPECTRUM.format("good.spd"), confined=False)
        assert folder / "good.spd" in file.sources()
    with pytest.warns(prosim_scene.SceneWarning, match="neither watched nor sent to a cluster"):
        opened(folder, "<![CDATA[ ]]> ]]>" + SPECTRUM.format("good.spd"), confined=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RuntimeError, match="Parsing of XML file"):
            opened(folder, "<shape", confined=False)


@pytest.mark.parametrize("include", [False, True])
def test_elements_too_deep_for_the_parser_are_refused(variant_rgb, folder, include):
    """Mitsuba's parser would end the process. A file that includes itself has the message of Mitsuba."""
    text = 20_000 * '<bsdf type="mask">' + '<bsdf type="diffuse"/>' + 20_000 * "</bsdf>"
    (folder / "deep.xml").write_text(HERE.format(text))
    with pytest.raises(RecursionError, match=r"xml \(line \d+, col \d+\): elements nested more than 1000 deep"):
        opened(folder, INCLUDE.format("deep.xml") if include else text, confined=False)
    with pytest.raises(RuntimeError, match="maximum include recursion depth"):
        opened(folder, INCLUDE.format("scene.xml"), confined=False)


def test_scene_file_does_not_replace_a_file_of_mitsuba(variant_rgb, folder):
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


def test_confinement_checks_the_text_that_mitsuba_parsed(variant_rgb, folder, monkeypatch):
    """What Mitsuba has parsed is looked at, not what was in the file before."""
    parse = mi.parser.parse_file

    def exchanged(config, path, **parameters):
        Path(path).write_text(HERE.format(texts.pop()))
        return parse(config, path, **parameters)

    monkeypatch.setattr(mi.parser, "parse_file", exchanged)
    (folder.parent / "other.xml").write_text(SKY)
    texts = [STRING.format("../secret.ply"), INCLUDE.format("../other.xml")]
    for says in ("changed while", "names"):
        with pytest.raises(OutsideError, match=says):
            opened(folder, "")
