"""The ``prosim`` command: what it writes, says and exits with."""

import subprocess
import sys

import mitsuba as mi
import numpy as np
from mitsuba_prosim import llvm
from mitsuba_prosim.scene import session
from mitsuba_prosim.stock_command import link
from prosim_scene import extras
from prosim_start import group
from running import PALITO, done, metadata, names, pixels, prosim, refused


def test_render_of_xml_imports_no_translator(scene):
    """Nor servers and multiprocessing, because their imports take longer than a small image; after the imports, garbage
    is collected again.
    """
    code = (
        "import gc, sys, prosim_start\ntry: prosim_start.main()\n"
        "except SystemExit as end: assert not end.code\n"
        "slow = {'lark', 'manifold3d', 'prosim_scene.language', 'asyncio', 'multiprocessing'}\n"
        "print(*slow & {*sys.modules}, gc.isenabled())"
    )
    command = [sys.executable, "-c", code, "render", str(scene)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert printed.splitlines()[1:] == ["True"]


def test_the_two_images_agree(scene):
    """Linear values in the EXR, with metadata; the same, twice as bright, in sRGB and 8 bits in the PNG."""
    done("render", scene, "-D", "radiance=0.25", "--seed", 3, "-t", 1, "--exposure", 1)
    assert np.allclose(pixels(scene.with_suffix(".exr")), 0.25, atol=1e-6)
    srgb = 255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055)
    assert np.all(np.abs(pixels(scene.with_suffix(".png")).astype(int) - srgb) <= 1)
    assert metadata(scene)["seed"] == "3" and metadata(scene)["scene"] == str(scene)


def test_a_wrong_scene_in_the_language(palito):
    palito.write_text(PALITO.read_text().replace("AREA-", "ARIA-").replace("LIGHTS", "LIHTS"))
    for command in "render", "translate", "format":
        refused("LIGHTS", command, palito)


def test_translate_writes_all_or_nothing(palito):
    done("translate", palito, "--check")
    assert names(palito.parent) == ["listing.scn"]
    printed = done("translate", palito, "--target", "stock", "--light-units", "radiance", "--tolerance", 0.5).stdout
    assert printed == f"{palito.with_suffix('.xml')}\n"
    assert names(palito.parent) == ["listing-meshes", "listing.scn", "listing.xml"]
    assert 'type="prosim' not in palito.with_suffix(".xml").read_text()


def test_unknown_commands(palito):
    for word, hint in [
        ("rneder", "Did you mean 'render'?"),
        ("zebra", ""),
        (palito, f"To render that file: prosim render {palito}"),
    ]:
        refused(f"No such command '{word}'. {hint}".rstrip() + "\n", word, palito)
    assert "No such option" in prosim("--rneder").stderr


def test_the_help_has_groups():
    for command in group.COMMANDS:
        assert f"Usage: prosim {command}" in done(command, "-h").output and command in done("-h").output
    printed = prosim("render", "-h").output
    groups = [line[:-1] for line in printed.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert groups == ["Quality", "Output", "Scene", "Film", "Distribution", "Advanced", "Others"]


def test_format(palito):
    """A link stays a link, and the file's mode stays."""
    palito.write_text(palito.read_text().replace("    ", " "))
    palito.chmod(0o600)
    link = palito.with_name("link.scn")
    link.symlink_to(palito)
    assert prosim("format", "--check", palito).exit_code == 1
    assert f"{link}, a link to {palito}: tidied" in done("format", link).stdout
    tidy = palito.read_text()
    assert done("format", palito).output == "" and palito.read_text() == tidy
    done("format", "--check", palito)
    assert link.is_symlink() and palito.stat().st_mode & 0o777 == 0o600
    assert names(palito.parent) == ["link.scn", "listing.scn"]


def test_doctor(monkeypatch):
    printed = prosim("doctor").stdout
    assert "mitsuba         " in printed and mi.__version__ in printed and "llvm_ad_rgb" in printed
    monkeypatch.setattr(llvm, "version", lambda: (15, 0, 6))
    monkeypatch.setattr(llvm.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(session, "has_backend", lambda variant: variant.startswith("scalar"))
    monkeypatch.setitem(extras.EXTRAS, "compare", ["no_such_module"])
    result = prosim("doctor")
    printed = " ".join(result.stdout.split())
    assert result.exit_code == 1 and "abort the process" in printed
    assert "not cuda_ad_rgb" in printed and "which need an NVIDIA GPU with its driver" in printed
    assert "compare needs no_such_module; to get it: pip install 'mitsuba-prosim[compare]'" in printed


def test_link_and_unlink(palito, linked, monkeypatch):
    """The script stays executable. It works without this package, too."""
    before, mode = linked.read_text(), linked.stat().st_mode
    done("link")
    assert linked.read_text() == before and linked.stat().st_mode == mode and "except ImportError" in before
    assert "runs plugins in Python" in done("doctor").stdout and "link" not in prosim("translate", palito).stderr
    done("link", "--remove")
    assert link.THEIRS in linked.read_text().splitlines()
    assert "to enable this: prosim link" in done("doctor").stdout
    assert "prosim link" in prosim("translate", palito).stderr
    monkeypatch.setattr(link, "script", lambda: None)
    assert "use prosim render" in prosim("link").stderr
