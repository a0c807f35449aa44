"""The ``prosim`` command: what it writes, says and exits with."""

import errno
import os
import sys
import warnings
from importlib.metadata import distribution

import click
import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim import llvm
from mitsuba_prosim.scene import session
from mitsuba_prosim.stock_command import stand_ins
from prosim_scene import extras
from prosim_start import group
from running import PALITO, XML, names, pixels, prosim


@pytest.mark.slow
def test_renders_the_thesis_scene(palito):
    """By default the images bear the name of the scene's file; nothing else is left behind."""
    done = prosim("render", palito, "--resolution", "40x40", "--samples", 2)
    assert done.exit_code == 0, done.output
    assert "listing.exr and " in done.stdout and "40 x 40 pixels" in done.stdout and done.stdout.count("\n") == 1
    assert names(palito.parent) == ["listing.exr", "listing.png", "listing.scn"]
    assert pixels(palito.with_suffix(".exr")).shape == (40, 40, 3)


def test_translation_renders_alike(palito):
    assert prosim("translate", palito, "-o", palito.parent / "out", "--resolution", "32x32").exit_code == 0
    for source, name in (palito, "a"), (palito.parent / "out" / "listing.xml", "b"):
        done = prosim("render", source, "-o", palito.with_name(name), "--resolution", "32x32", "--samples", 2)
        assert done.exit_code == 0, done.output
    assert np.array_equal(pixels(palito.with_name("a.exr")), pixels(palito.with_name("b.exr")))


def test_images_agree(scene):
    """Linear values in the EXR, with how it was made; the same, twice as bright, in sRGB and 8 bits in the PNG."""
    done = prosim("render", scene, "-D", "radiance=0.25", "--seed", 3, "-t", 1, "--exposure", 1)
    assert done.exit_code == 0, done.output
    exr, png = mi.Bitmap(str(scene.with_suffix(".exr"))), mi.Bitmap(str(scene.with_suffix(".png")))
    assert np.allclose(np.array(exr), 0.25, atol=1e-6)
    assert np.all(np.abs(np.array(png) - 255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055)) <= 1)
    assert exr.metadata()["prosim.seed"] == "3" and exr.metadata()["prosim.scene"] == str(scene)


@pytest.mark.slow
def test_crop_is_part_of_the_whole(palito):
    for name, crop in ("whole", []), ("part", ["--crop", "10,4,8,6"]):
        done = prosim("render", palito, "-o", palito.with_name(name), "--resolution", "32x32", "--samples", 2, *crop)
        assert done.exit_code == 0, done.output
    assert np.array_equal(pixels(palito.with_name("part.exr")), pixels(palito.with_name("whole.exr"))[4:10, 10:18])


@pytest.mark.parametrize(
    "text, says",
    [
        ("<scene version='3.0.0'><wrong/></scene>", "wrong"),
        (XML.replace("$radiance", "$missing"), "missing"),
        (XML.replace("path", "prosim_missing"), "not found"),
        (XML.replace('type="nrook">', 'type="nrook"><string name="jitter" value="much"/>'), "multi"),
        ("<scene version='3.0.0'/>", "No sensor specified"),
    ],
)
def test_wrong_scene(scene, text, says):
    scene.write_text(text)
    done = prosim("render", scene)
    assert done.exit_code == 2
    assert says in done.stderr and "Traceback" not in done.stderr and ".cpp" not in done.stderr
    assert names(scene.parent) == ["scene.xml"]


def test_wrong_scene_in_the_language(palito):
    palito.write_text(PALITO.read_text().replace("AREA-", "ARIA-").replace("LIGHTS", "LIHTS"))
    for command in "render", "translate", "format":
        done = prosim(command, palito)
        assert done.exit_code == 2
        assert "LIGHTS" in done.stderr and "^" in done.stderr
    assert names(palito.parent) == ["listing.scn"]


def test_an_image_survives_a_failed_render(scene):
    assert prosim("render", scene).exit_code == 0
    before = scene.with_suffix(".exr").read_bytes()
    scene.write_text(XML.replace("path", "prosim_missing"))
    assert prosim("render", scene).exit_code == 2
    assert scene.with_suffix(".exr").read_bytes() == before


def test_translate_writes_all_or_nothing(palito):
    assert prosim("translate", palito, "--check").exit_code == 0
    assert names(palito.parent) == ["listing.scn"]
    done = prosim("translate", palito, "--target", "stock", "--light-units", "radiance", "--tolerance", 0.5)
    assert done.exit_code == 0 and done.stdout == f"{palito.with_suffix('.xml')}\n"
    assert names(palito.parent) == ["listing-meshes", "listing.scn", "listing.xml"]
    assert 'type="prosim' not in palito.with_suffix(".xml").read_text()


@pytest.mark.skipif(sys.platform != "linux", reason="the stand-ins exist for Linux only")
def test_what_is_missing_for_the_mitsuba_command_is_said_in_a_line(palito, monkeypatch, tmp_path_factory):
    """As where the package comes from a wheel. Nothing at all is no trouble, some are."""
    folder = tmp_path_factory.mktemp("plugins")
    monkeypatch.setattr(stand_ins, "plugin_folder", lambda: folder)
    monkeypatch.setattr(llvm, "problem", lambda: None)
    assert "for the mitsuba command, run once: prosim link" in prosim("translate", palito).stderr
    done = prosim("doctor")
    assert done.exit_code == 0 and "to let it: prosim link" in done.stdout
    (folder / "nrook.so").write_bytes(stand_ins.MARK)
    assert "prosim link" not in prosim("translate", palito).stderr
    done = prosim("doctor")
    assert done.exit_code == 1 and "can't run direct_projective, " in done.stdout and "Run: prosim link" in done.stdout


@pytest.mark.parametrize("compiler", ["/nowhere/cc", "false"])
def test_compiler_that_fails(compiler, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(RuntimeError, match="the C compiler failed"):
        stand_ins.compile_stand_in(tmp_path / "a.so")


def test_a_command_that_there_is_not(palito):
    for word, hint in [
        ("rneder", "Did you mean 'render'?"),
        ("paint", ""),
        (palito, f"To render that file: prosim render {palito}"),
    ]:
        done = prosim(word, palito)
        assert done.exit_code == 2 and f"No such command '{word}'. {hint}".rstrip() + "\n" in done.stderr
    assert "No such option" in prosim("--rneder").stderr
    completing = click.Context(group.prosim, resilient_parsing=True)
    assert group.prosim.resolve_command(completing, ["rneder"])[1] is None


def test_an_old_name_of_an_option_is_understood_and_not_in_the_help(scene):
    done = prosim("render", scene, "--anew")
    assert done.exit_code == 2 and "--overwrite is for films" in done.stderr
    said = prosim("render", "-h").output
    assert "--overwrite" in said and "--anew" not in said


def test_the_help_has_groups():
    said = prosim("render", "-h").output
    groups = [line[:-1] for line in said.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert groups == ["Quality", "Output", "Scene", "Film", "Distribution", "Advanced", "Others"]


def test_a_warning_is_said_once(capsys):
    """Though Python forgets that it has said it whenever its filters change."""
    with warnings.catch_warnings():
        group.prosim.callback()
        for _ in range(2):
            with warnings.catch_warnings():
                warnings.simplefilter("always")
                warnings.warn("the same", stacklevel=1)
    assert capsys.readouterr().err == "warning: the same\n"


def test_format(palito):
    assert prosim("format", "--check", palito).exit_code == 1
    assert prosim("format", palito).exit_code == 0
    tidy = palito.read_text()
    assert prosim("format", "--check", palito).exit_code == 0
    assert prosim("format", palito).output == "" and palito.read_text() == tidy
    assert names(palito.parent) == ["listing.scn"]


def test_format_keeps_the_link_and_the_mode(palito):
    palito.chmod(0o600)
    link = palito.with_name("link.scn")
    link.symlink_to(palito)
    assert prosim("format", link).exit_code == 0
    assert link.is_symlink() and palito.stat().st_mode & 0o777 == 0o600
    assert prosim("format", "--check", palito).exit_code == 0


def test_format_says_what_it_could_not_write(palito, monkeypatch):
    """And not that it has."""

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(palito.parent))

    monkeypatch.setattr(os, "replace", full)
    done = prosim("format", palito)
    assert done.exit_code == 1 and done.stdout == ""
    assert f"{palito}: No space left on device; the file is as it was" in done.stderr
    assert names(palito.parent) == ["listing.scn"]


def test_doctor_finds_all_well_or_says_what_to_do(monkeypatch):
    done = prosim("doctor")
    assert "mitsuba         " in done.stdout
    assert mi.__version__ in done.stdout and "llvm_ad_rgb" in done.stdout
    monkeypatch.setattr(llvm, "version", lambda: (15, 0, 6))
    monkeypatch.setattr(llvm.platform, "machine", lambda: "x86_64")
    done = prosim("doctor")
    assert done.exit_code == 1 and "abort the process" in done.stdout


def test_doctor_says_what_an_installation_lacks(monkeypatch, tmp_path):
    """No compiler, no GPU, and not the packages of prosim compare."""
    monkeypatch.setattr(stand_ins, "plugin_folder", lambda: tmp_path)
    monkeypatch.setattr(stand_ins, "compiler", lambda: None)
    monkeypatch.setattr(session, "has_backend", lambda variant: variant.startswith("scalar"))
    monkeypatch.setitem(extras.EXTRAS, "compare", {"no_such_module": "no-such-package"})
    done = prosim("doctor")
    said = " ".join(done.stdout.split())
    assert "not cuda_ad_rgb" in said and "which need an NVIDIA GPU with its driver" in said and "need LLVM" in said
    assert "compare needs no-such-package; to get it: pip install 'mitsuba-prosim[compare]'" in said
    if sys.platform == "linux":
        assert "C compiler none (only prosim link needs one)" in said
        done = prosim("link")
        assert done.exit_code == 1 and "apt install gcc" in done.stderr


compiled = pytest.mark.skipif(
    sys.platform != "linux" or not stand_ins.compiler(), reason="needs a C compiler, on Linux"
)


@compiled
def test_link_and_unlink(own, tmp_path, monkeypatch):
    folder, listed = tmp_path / "plugins", []
    folder.mkdir()
    (folder / "path.so").write_bytes(b"Mitsuba's own")
    monkeypatch.setattr(stand_ins, "plugin_folder", lambda: folder)
    monkeypatch.setattr(stand_ins, "record", listed.extend)
    done = prosim("link")
    assert done.exit_code == 0, done.output
    assert {"prosim_conductor", "nrook", "prb"} <= set(stand_ins.installed())
    assert {path.name for path in listed} | {"path.so"} == set(names(folder))
    assert prosim("link", "--remove").exit_code == 0
    assert names(folder) == ["path.so"]


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A distribution "own" in ``tmp_path``, which ``prosim link`` takes for this package's."""
    info = tmp_path / "own-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1\n")
    (info / "RECORD").write_text("own-1.dist-info/RECORD,,\n")
    monkeypatch.setattr(stand_ins, "distribution", lambda _: distribution("own"))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_record_lists_a_file_once(own):
    """What pip removes on uninstalling."""
    files = own / "mitsuba" / "plugins" / "a.so", own.parent / "elsewhere.so"
    files[0].parent.mkdir(parents=True)
    for file in files:
        file.touch()  # what is not there is not listed, where importlib_metadata has been imported
    for _ in range(2):
        stand_ins.record(files)
    lines = (own / "own-1.dist-info" / "RECORD").read_text().splitlines()
    assert lines[1:] == ["mitsuba/plugins/a.so,,", "../elsewhere.so,,"]


@pytest.mark.parametrize("command", group.COMMANDS)
def test_help(command):
    done = prosim(command, "-h")
    assert done.exit_code == 0 and f"Usage: prosim {command}" in done.output
    assert command in prosim("-h").output
