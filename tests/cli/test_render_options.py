"""``prosim render``: its options, and what they refuse; files of other kinds; the places of errors in XML."""

import gzip
import os
import re
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import prosim_scene
import pytest
from mitsuba_prosim.cli import render_commands, terminal
from mitsuba_prosim.cli.job import Job
from mitsuba_prosim.scene import scene_file
from mitsuba_prosim.scene.errors import with_line, with_suggestion
from mitsuba_prosim.scene.rendering import with_targets
from running import AOV, LIT_FLOOR, PATH, XML, done, prosim, refused, scene_text
from tqdm import tqdm

NOT_WITH_SPP = ["noise 0.1", "time 1", "adaptive graded", "max-samples 9", "snapshots 2s"]


@pytest.mark.parametrize(
    "arguments, says",
    [
        ("--resolution 40", "not of the form WxH, such as 640x480"),
        *((f"--resolution {size}", "1 to 65536 pixels a side") for size in ("0x4", "65537x1", "32768x8193")),
        ("--crop 1,2,3", "not of the form X,Y,W,H"),
        ("--crop 12,0,1,1", "window 12,0,1,1 is not within the image of 12x8 pixels"),
        ("--samples 2", "Any of --noise, --noise-99, --time, --max-samples, --adaptive puts one of them"),
        ("-D key", "not of the form key=value"),
        ("-m no_such_variant", "llvm_ad_rgb"),
        ("--spp 4 --samples 2", "give one of them"),
        *[(f"--spp 4 --{option}", "leave it out with --noise") for option in NOT_WITH_SPP],
        ("-s 7", "out of bounds! The scene has sensors 0 to 0."),
        ("--exposure nan", "finite"),
        ("--caustics", "prosim has --caustics; this scene's is path, which --paths"),
        ("--layers lights --caustics", "--layers lights: the photons of --caustics"),
        ("--noise 0.1 --adaptive thesis", "--adaptive thesis does not"),
        ("--snapshots 0.1 --adaptive thesis", "--adaptive thesis does not"),
        ("--noise-99 0.1 -m scalar_rgb", "--noise-99: scalar_rgb"),
        ("-D a\udcff=1", "a?: Mitsuba reads only names and values in UTF-8"),
        ("--light-units radiance", "--light-units: only for scenes in the thesis's language"),
        ("--snapshots 0.1,4s", "errors or times, not both"),
        ("--snapshots x", "X,X"),
        ("--snapshots 0.1 --time 4", "--time alone does not measure the error"),
        ("--denoise --layers lights", "--denoise"),
        ("--checkpoint", "--checkpoint needs prosim or prosim_adaptive"),
        ("--samples 2 -m scalar_rgb", "--samples: scalar_rgb"),
        ("--checkpoint -m scalar_rgb", "--checkpoint: scalar_rgb"),
        ("--part 1/2 --time 2", "need the whole image"),
        ("--part 1/2 --denoise", "--denoise needs the whole image"),
        ("--part 3/2", "part 3 of 2"),
        ("--part 3", "not of the form K/M"),
        ("--workers 2 --cluster tcp://a:1", "give one of them"),
        ("--workers 2 --part 1/2", "leave out --part with a cluster"),
        ("--workers 2", "needs prosim or prosim_adaptive"),
        ("--cluster localhost", "'localhost' is not of the form ADDRESS, such as tcp://machine:8786"),
        ("--frames 3:3", "B must be greater than A"),
        *[(f"--frames={frames}", "not of the form A:B[:STEP]") for frames in ("-1:3", "9:0:-1", "a:b", "0:3:1:1")],
        ("--frames 0:3 -D frame=3", "-D frame=... and --frames both define $frame"),
        ("--frames 0:3 --part 1/2", "--part is for single images"),
        ("--frames 0:3 --workers 2 -m scalar_rgb", "--workers: scalar_rgb"),
        ("--frames 0:2", "Found unused parameters:\n  - $frame=0"),
        *[(f"--crop {n}", "is not within the image") for n in ("4294967295,0,1,1", f"0,{2**64},1,1", f"0,0,{2**32},9")],
    ],
)
def test_wrong_use(scene, arguments, says):
    refused(says, "render", scene, *arguments.split())


def test_unlimited_depth_of_a_tree_is_refused_by_its_option(palito):
    refused("--max-level -1: a ray tree has 0 to 24 levels", "render", palito, "--max-level", -1)


def test_resolution_of_a_scene_that_no_film_can_hold(palito):
    palito.write_text(re.sub(r"RESOLUTION\W*\d+ \d+", "RESOLUTION: 65536 65536", palito.read_text()))
    refused("too many pixels", "render", palito, "--tolerance", 1000)


def integrator_of(scene, **options):
    """That of the scene with these options of the command."""
    return scene_file.SceneFile(scene, scene.parent / "out", integrator=Job(**options).integrator).load().integrator()


@pytest.mark.parametrize("suffix", [".scn", ".xml"])
def test_parameters_of_the_integrator(palito, variant_rgb, suffix):
    scene = palito if suffix == ".scn" else prosim_scene.translate(palito)
    others = {"max_level": 2, "samples": 2}
    for asked, expected in [
        ({"paths": True}, {"diffuse_bounces": -1, "max_level": -1}),
        ({"paths": True} | others, {"diffuse_bounces": -1} | others),
        ({"max_level": 0}, {"diffuse_bounces": 0, "max_level": 0}),
    ]:
        made = integrator_of(scene, **asked)
        assert all(f"{name} = {value}" in str(made) for name, value in expected.items())
        assert (made.ambient is None) == ("paths" in asked)


def test_the_number_of_samples_has_one_name(palito, tmp_path, variant_rgb):
    """It is a parameter of the integrator, also where the translation needs it; another argument is an error."""
    file = scene_file.SceneFile(palito, tmp_path / "out", integrator={"samples": 3})
    loaded = file.load()
    assert loaded.integrator().sampling.samples == 3 and loaded.sensors()[0].sampler().sample_count() == 9
    for path in palito, file.xml:
        with pytest.raises(TypeError, match="no such argument: samples, size; integrator="):
            scene_file.SceneFile(path, tmp_path / "out", integrator={"samples": 3}, samples=2, size=(8, 8))
        scene_file.SceneFile(path, tmp_path / "out", tolerance=None, allow_outside=False)


@pytest.mark.parametrize("written, asked", [(False, None), (False, True), (True, None), (True, False)])
def test_caustics_option_overrides_the_scene(palito, variant_rgb, written, asked):
    palito.write_text("CAUSTICS TRUE\n" * written + palito.read_text(encoding="utf-8"), encoding="utf-8")
    assert integrator_of(palito, caustics=asked).caustics is (written if asked is None else asked)


def test_the_command_line_makes_a_job(scene, monkeypatch):
    jobs = []
    monkeypatch.setattr(render_commands, "render_and_write", lambda job, *_, **__: jobs.append(job))
    for options in "", "--caustics", "--no-caustics --noise 0.01", "-D a=1 -D b=2=3 --noise-99 0.5 -vv":
        assert prosim("render", scene, *options.split()).exit_code == 0
    expected = {}, {"caustics": True}, {"caustics": False, "noise": 0.01, "adaptive": "graded"}
    assert tuple(job.integrator for job in jobs[:3]) == expected
    assert jobs[0] == Job(scene=str(scene), variant=jobs[0].variant, definitions={})
    assert (jobs[3].definitions, jobs[3].noise_99, jobs[3].verbose) == ({"a": "1", "b": "2=3"}, 0.5, 2)


@pytest.mark.parametrize(
    "size, distorts", [((16, 8), True), ((16, 16), False), ((17, 16), False), ((504, 500), False), ((510, 500), True)]
)
def test_a_resolution_that_distorts_is_warned_of(palito, tmp_path, variant_rgb, recwarn, size, distorts):
    """palito's window is a square."""
    scene_file.SceneFile(palito, tmp_path / "out", resolution=size)
    assert any(f"{size[0]}x{size[0]} or {size[1]}x{size[1]} would not" in str(w.message) for w in recwarn) == distorts


def test_progress_is_shown_from_the_beginning(scene, monkeypatch):
    """On a terminal there is a word before the first step, while kernels are compiled."""
    words, screen = [], SimpleNamespace(isatty=lambda: True, write=str, flush=str)
    monkeypatch.setattr(terminal, "sys", SimpleNamespace(stderr=screen, stdout=screen))
    for name in "refresh", "update":
        monkeypatch.setattr(tqdm, name, lambda self, *_, **__: words.append(self.desc))
    scene.write_text(XML.replace('"path"/>', '"prosim"><integer name="samples" value="2"/></integrator>'))
    done("render", scene)
    assert words[0] == "compiling kernels" and set(words[1:]) == {"rendering"}


# ---- Files that do not exist, or are of another kind than a command needs


@pytest.mark.parametrize(
    "command, path, says",
    [
        *[(name, "mug", "does not exist. Did you mean mug.scn?\n") for name in ("render", "compare", "watch", "mix")],
        ("render", "scense/jug.scn", "File 'scense/jug.scn' does not exist.\n"),
        ("render", "folder.xml", "File 'folder.xml' is a directory.\n"),
        *[(name, "mug.exr", "is an image; prosim mix") for name in ("render", "translate", "format", "resume")],
        *[(name, "image", "this is not a text in UTF-8") for name in ("render", "translate")],
        *[(name, "text", "is no checkpoint; give a file by") for name in ("resume", "merge")],
        *[(name, "mug.npz", "continue it by prosim resume") for name in ("render", "mix", "translate")],
        *[
            (name, "pipe.xml", "is a Mitsuba scene; render it by prosim render")
            for name in ("translate", "resume", "mix")
        ],
        ("mix", "text", "is not a readable EXR image"),
        *[(name, "/dev/zero", "a device or a pipe") for name in ("render", "translate", "watch", "mix", "merge")],
        *[("render", name, "a device or a pipe") for name in ("pipe.xml", "pipe")],
    ],
)
def test_wrong_files_are_refused(tmp_path, monkeypatch, command, path, says):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.xml")
    os.mkfifo("pipe")
    Path("folder.xml").mkdir()
    for name in "mug.scn", "mug.npz", "text":
        Path(name).write_text("SCENE")
    for name in "mug.exr", "image":
        Path(name).write_bytes(b"\x76\x2f\x31\x01" + bytes(40))
    refused(says, command, path, *["a=1"] * (command == "mix"), folder=tmp_path)


# ---- An error in an XML scene shows its place as one in a scene of the language does


PLACED = """<scene version="3.0.0">
    <sensor type="perspective"/>
    <shape type="sphere">
\t<float name="radius" value="1"/></shape>
</scene>
"""


@pytest.mark.parametrize(
    "old, new, line, under",
    [
        ('type="sphere"', 'type="spheree"', "    <shape", "shape"),
        ('"1"/>', '"wide"/>', " <float name", "float"),
        ("</shape>", "", "</scene>", "scene>"),
    ],
)
def test_places_in_xml_have_a_caret(write_scene, old, new, line, under):
    done = prosim("render", write_scene(PLACED.replace(old, new), "a scene.xml"), "-m", "scalar_rgb")
    assert done.exit_code == 2
    quoted, caret = done.output.splitlines()[-2:]
    assert quoted.startswith(f"    {line}") and caret.strip() == "^"
    assert quoted[caret.index("^") :].startswith(under)
    assert ('"spheree" not found! Did you mean sphere?\n' in done.output) == ("spheree" in new)


def test_suggested_plugin_has_the_requested_type(variant_rgb):
    words = 'failed to instantiate {} plugin of type "{}": [PluginManager] Plugin "{}" not found!'
    for kind, name, meant in [
        ("bsdf", "roughconductorr", " Did you mean roughconductor?"),
        ("bsdf", "prosim_composit", " Did you mean prosim_composite?"),
        ("rfilter", "mitchel", " Did you mean mitchell?"),
        ("shape", "roughconductorr", ""),
        ("bsdf", "xyzzy", ""),
        ("integrator", "paht", " Did you mean path?"),
        ("integrator", "sppm", " With --paths, prosim render, explain and watch do without it."),
    ]:
        said = words.format(kind, name, name)
        assert with_suggestion(f"{said}\nmore") == f"{said}{meant}\nmore"


def test_no_line_of_another_folder_is_shown_by_a_scenes_own_words(tmp_path):
    scene, part, secret = tmp_path / "scene" / "scene.xml", tmp_path / "scene" / "part.xml", tmp_path / "secret.xml"
    scene.parent.mkdir()
    for path in (secret, part):
        path.write_text(f"<{path.stem}/>")
    scene.symlink_to(part)
    (scene.parent / "link.xml").symlink_to(secret)
    (tmp_path / "named.xml").symlink_to(part)
    for path, shown in ((secret, False), (scene.parent / "link.xml", False), (part, True), (scene, True)):
        words = f'could not parse floating point value "At "{path}" (line 1, col 2)"'
        assert (with_line(words, scene) != words) == shown
    words = f"While loading {tmp_path}/named.xml (line 1, col 2): wrong"
    assert with_line(words, tmp_path / "named.xml").endswith("\n    <part/>\n     ^")


def test_message_without_a_readable_line_is_unchanged(tmp_path, write_scene):
    """Words without a place, or with one that is not there to be read."""
    gone = f"At {tmp_path}/gone.xml (line 3, col 6): failed"
    for words in ("[Film] too wide", gone, 'Loading "a.ply" (line 1, col 1)'):
        assert with_line(words) == words
    short = write_scene("<scene/>\n", "short.xml")
    said = f"While loading {short} (line {{}}, col 2): wrong\n  - more"
    assert with_line(said.format(9)) == said.format(9)
    assert re.search(r"more\n    <scene/>\n     \^$", with_line(said.format(1)))
    outer = f"Error while loading {tmp_path}/gone.xml (line 1, col 2): while processing <include>:\n"
    assert with_line(outer + said.format(1)).endswith("     ^")


@pytest.mark.parametrize(
    "integrator",
    [
        "",
        PATH,
        '<integrator type="volpath"/>',
        '<integrator type="ptracer"/>',
        AOV.format(PATH),
        '<integrator type="prosim_adaptive"><integrator type="path"/><integer name="samples" value="2"/></integrator>',
        f'<integrator type="prosim_denoised">{PATH}</integrator>',
    ],
)
def test_paths_replace_any_integrator(scene, variant_rgb, integrator):
    """The image is that of path: the light of the sky, and of what the floor reflects."""
    if "denoised" in integrator:
        pytest.importorskip("mitsuba_oidn")
    scene.write_text(scene_text(integrator, LIT_FLOOR))
    assert "prosim in place of " in done("render", scene, "--paths").stdout
    made = integrator_of(scene, paths=True)
    assert getattr(made, "nested", made).diffuse_bounces == -1
    assert "aov" not in integrator or made.aov_names()[0] == "d.T"


@pytest.mark.parametrize("around", ["{}", '<integrator type="prosim_adaptive">{}</integrator>', AOV])
@pytest.mark.parametrize("plugin", ["path", "volpath", "ptracer"])
def test_paths_keep_the_parameters_of_the_integrator(scene, variant_rgb, plugin, around):
    """With ``max_depth`` 2, light is reflected once, which is level 0 of prosim; the user's level has precedence."""

    def made(depth, **options):
        numbers = f'<integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="7"/>'
        hides = '<boolean name="hide_emitters" value="true"/>'
        text = around.format(f'<integrator type="{plugin}">{numbers}{hides}</integrator>')
        scene.write_text(scene_text(text, LIT_FLOOR))
        return integrator_of(scene, paths=True, **options)

    assert [made(depth).max_level for depth in (2, 3, 8, -1)] == [0, 1, 6, -1]
    assert made(8, max_level=-1).max_level == -1 and made(1, max_level=3).max_level == 3
    assert made(2).hide_emitters and made(2).rr_depth == 7
    with pytest.raises(ValueError, match="max_depth 1 allows no reflection"):
        made(1)


def test_paths_keep_the_channels_of_nested_integrators(scene, variant_rgb):
    samples = '<integrator type="prosim_adaptive"><string name="aovs" value="samples"/>{}</integrator>'
    scene.write_text(scene_text(samples.format(AOV.format(PATH)), LIT_FLOOR))
    assert integrator_of(scene, paths=True).aov_names() == ["d.T", "samples"]


@pytest.mark.parametrize("depth, rr_depth, hides", [(-1, 5, False), (2, 5, True), (8, 9, False)])
def test_with_a_target_prosim_follows_the_paths_of_path(scene, variant_rgb, depth, rr_depth, hides):
    """In the place of ``path`` in a file, and in a loaded scene."""
    limits = f'<integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="{rr_depth}"/>'
    limits += f'<boolean name="hide_emitters" value="{str(hides).lower()}"/>'
    scene.write_text(scene_text(f'<integrator type="path">{limits}</integrator>', LIT_FLOOR))
    loaded = mi.load_file(str(scene))
    for ours in (integrator_of(scene, noise=0.05), with_targets(loaded.integrator(), loaded)):
        assert (ours.max_level, ours.diffuse_bounces) == (max(depth - 2, -1), -1)
        assert (ours.rr_depth, ours.hide_emitters) == (rr_depth, hides)
    assert "prosim in place of path" in done("render", scene, "--noise", 0.1).stdout


def test_ptracer_cannot_reach_a_target(scene, variant_rgb):
    scene.write_text(scene_text('<integrator type="ptracer"/>', LIT_FLOOR))
    loaded = mi.load_file(str(scene))
    with pytest.raises(ValueError, match="ParticleTracerIntegrator follows light from the lamps"):
        with_targets(loaded.integrator(), loaded)
    says = "scene.xml: ptracer follows light from the lamps, and has no target; give --spp"
    for option in "--noise", "--time":
        refused(says, "render", scene, option, 1)


HOLE = '<shape type="sphere"><bsdf type="mask"><bsdf type="diffuse"/></bsdf></shape>'
SMOKE = '<shape type="sphere"><medium name="interior" type="homogeneous"/><bsdf type="null"/></shape>'


@pytest.mark.parametrize(
    "limit, content",
    [
        ('<integer name="max_depth" value="1"/>', ""),
        ('<boolean name="hide_emitters" value="true"/>', HOLE),
        ("", SMOKE),
        ("", f'<shape type="shapegroup" id="g">{SMOKE}</shape><shape type="instance"><ref id="g"/></shape>'),
    ],
)
def test_with_a_target_path_is_kept_where_prosim_has_another_image(scene, variant_rgb, limit, content):
    scene.write_text(scene_text(f'<integrator type="path">{limit}</integrator>', LIT_FLOOR + content))
    assert "path within prosim_adaptive" in done("render", scene, "--noise", 0.1).stdout
    loaded = mi.load_file(str(scene))
    assert "PathIntegrator" in str(with_targets(loaded.integrator(), loaded).nested)


@pytest.mark.parametrize("option", [("--noise", 0.1), ("--spp", 1), ("--paths",)])
@pytest.mark.parametrize(
    "plugin, wrong, says",
    [
        ("path", '<integer name="depth" value="3"/>', "path has no parameter depth"),
        ("path", '<string name="max_depth" value="3"/>', '"max_depth" has the wrong type (expected '),
        ("path", '<integer name="max_depth" value="-5"/>', '"max_depth" must be set to -1'),
        ("path", '<bsdf type="diffuse"/>', "path has no parameter"),
        ("volpath", '<string name="max_depth" value="3"/>', '"max_depth" has the wrong type (expected '),
        ("aov", f'<integer name="aovs" value="3"/>{PATH}', '"aovs" has the wrong type (expected '),
    ],
)
def test_what_mitsuba_refuses_of_an_integrator_is_refused(scene, option, plugin, wrong, says):
    """Also of parameters that options read and replace."""
    scene.write_text(scene_text(f'<integrator type="{plugin}">{wrong}</integrator>', LIT_FLOOR))
    refused(says, "render", scene, *option)


def test_old_names_of_parameters_are_known(scene, variant_rgb):
    """Those of scenes for Mitsuba before 2.0."""
    limit = '<integrator type="path"><integer name="maxDepth" value="4"/></integrator>'
    text = scene_text(limit, LIT_FLOOR).replace("3.0.0", "0.6.0").replace("sample_count", "sampleCount")
    scene.write_text(text)
    file = scene_file.SceneFile(scene, scene.parent, integrator={"noise": 0.05})
    loaded = file.load(sampler="owen")
    assert loaded.integrator().max_level == 2 and loaded.sensors()[0].sampler().sample_count() == 4


@pytest.mark.parametrize("nested", ["path", "prosim", "prosim_adaptive", "aov"])
def test_target_goes_to_the_integrator_that_prosim_denoised_nests(scene, variant_rgb, nested):
    inner = "" if nested in ("path", "prosim") else '<integrator type="path"/>'
    aovs = '<string name="aovs" value="d:depth"/>' * (nested == "aov")
    text = f'<integrator type="prosim_denoised"><integrator type="{nested}">{inner}{aovs}</integrator></integrator>'
    scene.write_text(scene_text(text, LIT_FLOOR))
    for options in ({}, {"paths": True}):
        made = integrator_of(scene, noise=0.05, **options)
        assert "denoised.R" in made.aov_names() and made.nested.noise == 0.05


def test_resolution_of_a_film_with_a_crop_window_needs_a_crop(scene):
    window = "".join(f'<integer name="crop_{name}" value="2"/>' for name in ("offset_x", "offset_y", "width", "height"))
    scene.write_text(XML.replace("</film>", f"{window}</film>"))
    refused("the film has the crop window 2,2,2,2 of 12x8 pixels", "render", scene, "--resolution", "24x16")
    for arguments in [("12x8",), ("24x16", "--crop", "4,4,2,2")]:
        assert "2 x 2 pixels" in done("render", scene, "--resolution", *arguments).stdout


@pytest.mark.parametrize("arguments", ["--resolution 4x4", "--crop 8,4,4,4"])
def test_only_the_film_of_the_sensor_changes(scene, arguments):
    """The others have a crop window, which --resolution does not change, or are too small for that of --crop."""
    first, film, rest = re.fullmatch(r"(.*)(<sensor.*</film>)(.*)", XML, re.DOTALL).groups()
    cropped = film.replace('"12"', '"6"').replace("</film>", '<integer name="crop_width" value="2"/></film>')
    shape = f'<shape type="rectangle">{film.replace("perspective", "irradiancemeter")}</sensor></shape>'
    scene.write_text(f"{first}{shape}{cropped}</sensor>{film}</sensor>{cropped}{rest}")
    for sensor in 1, 3:
        report = done("render", scene, "-s", sensor, *arguments.split()).stdout
        assert "4 x 4 pixels" in report
    refused("crop window", "render", scene, *arguments.split())


@pytest.mark.parametrize("arguments", ["--resolution 6x4", "--crop 9,9,6,4"])
def test_sensor_without_a_film_gets_the_size(scene, arguments):
    scene.write_text(re.sub("<film.*</film>", "", XML))
    assert "6 x 4 pixels" in done("render", scene, *arguments.split()).stdout


#: A crop window without pixels, and a shape from a file that does not exist.
EMPTY = '<integer name="crop_width" value="{}"/><integer name="crop_height" value="{}"/></film>'
LIT = scene_text(content=LIT_FLOOR + '<emitter type="directional"></emitter>')
HAIR = '<shape type="bsplinecurve"><string name="filename" value="no.txt"/></shape>'
PACKED = '<shape type="ply"><string name="filename" value="packed.ply"/></shape>'


def ball(plugin, parameter):
    return scene_text(content=f'<shape type="sphere"><bsdf type="prosim_{plugin}">{parameter}</bsdf></shape>')


@pytest.mark.parametrize(
    "text, says",
    [
        ("<scene version='3.0.0'><wrong/></scene>", "wrong"),
        ("<scene version='3.0.0'/>", "No sensor specified for scene; add the element <sensor>, which is the camera.\n"),
        (XML.replace("$radiance", "$missing"), "missing"),
        (XML.replace("path", "prosim_missing"), "not found"),
        (XML.replace('type="nrook">', 'type="nrook"><string name="jitter" value="much"/>'), "multi"),
        (scene_text(sampler="stratified", spp=0), "in the sampler stratified; give 1"),
        (scene_text('<integrator type="prosim"/>', sampler="nrook", spp=0), "in the sampler nrook; give 1"),
        *[(XML.replace("</film>", EMPTY.format(*size)), "the crop window") for size in ((0, 4), (4, -1))],
        (XML.replace('integer name="width"', 'string name="width"'), '"width" has the wrong type'),
        (XML.replace("</film>", '<string name="crop_width" value="4"/></film>'), '"crop_width" has the wrong type'),
        (XML.replace('integer name="sample_count"', 'string name="sample_count"'), '"sample_count" has the wrong type'),
        *[
            (LIT.replace(f'"{plugin}">', f'"{plugin}"><float name="unheard_of" value="1"/>', 1), "parameter unheard_of")
            for plugin in ("perspective", "sphere", "rectangle", "directional")
        ],
        (ball("lambertian", '<rgb name="kd" value="1"/>'), "parameter kd; it has reflectance, ambient\n"),
        (ball("phong", '<float name="exponnt" value="9"/>'), "exponnt. Did you mean exponent?\n"),
        (ball("conductor", '<string name="material" value="Copper"/>'), "allowed: none, Ag, Al"),
        (scene_text(content=HAIR), 'from "no.txt": file not found!\n'),
        # Mitsuba ends the process, or cannot tell why.
        (ball("lambertian", '<texture type="bitmap"/>'), "(line 8, col 58): this bitmap has no filename"),
        (scene_text(content='<bsdf type="blendbsdf"/>'), "(line 8, col 6): this blendbsdf has no weight"),
        (ball("\udce7ava", ""), "prosim_\ufffdava: this is not UTF-8; save the file as UTF-8, or unpack it\n"),
        (scene_text(content=PACKED), "this is not UTF-8; save the file as UTF-8, or unpack it\n"),
        (ball("lambertian", '<texture name="kd" type="checkerboard"/>'), "parameter kd; it has reflectance, ambient\n"),
    ],
)
def test_wrong_scene_writes_nothing(scene, text, says):
    """Images of before stay."""
    scene.with_suffix(".exr").write_bytes(b"before")
    scene.with_name("packed.ply").write_bytes(gzip.compress(b"ply\n"))
    scene.write_text(text, errors="surrogateescape")
    refused(says, "render", scene)
    assert scene.with_suffix(".exr").read_bytes() == b"before"


@pytest.mark.parametrize("option", ["--noise", "--spp"])
def test_missing_integrator_is_shown_at_its_line(scene, option):
    scene.write_text(scene_text('<integrator type="pathh"/>'))
    refused('(line 3, col 6): failed to instantiate integrator plugin of type "pathh"', "render", scene, option, 1)
