"""The native ``mitsuba`` command renders scenes that name our plugins, and its Python side is like it."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim import registry
from mitsuba_prosim.compat import PLUGINS_IN_PYTHON
from mitsuba_prosim.stock_command import hosted, stand_ins
from running import CONSTANT, compiled, pixels, scene_text
from waiting import PATIENCE, started

BITMAP = '<texture name="reflectance" type="bitmap"><string name="filename" value="wood.png"/></texture>'


def write(folder, name, sampler="nrook", bsdf="prosim_lambertian", inside="", **how):
    """A scene of 24 x 16 pixels with a ball."""
    path = folder / name
    ball = '<shape type="sphere"><transform name="to_world"><translate z="4"/></transform>'
    content = f'{CONSTANT}{ball}\n<bsdf type="{bsdf}">{inside}</bsdf></shape>'
    size = {"width": 24, "height": 16}
    path.write_text(scene_text('<integrator type="direct"/>', content, sampler=sampler, **size | how))
    return path


COMMAND = shutil.which("mitsuba", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


@pytest.fixture(scope="module")
def plugins(tmp_path_factory):
    """A folder of stand-ins, those of this source. The command looks into ``plugins`` of the current folder first."""
    folder = tmp_path_factory.mktemp("plugins")
    stand_ins.install(stand_ins.plugin_names(), folder)
    return folder


@pytest.fixture
def mitsuba(plugins):
    """Runs the command in a folder, which gets the stand-ins."""

    def run(folder, *arguments, **env):
        if not (folder / "plugins").exists():
            (folder / "plugins").symlink_to(plugins)
        how = {"cwd": folder, "env": os.environ | env, "capture_output": True, "text": True, "timeout": PATIENCE}
        return subprocess.run([COMMAND, *map(str, arguments)], check=False, **how)

    return run


def test_every_plugin_in_python_has_a_stand_in(variant_rgb):
    assert set(registry.PLUGINS) | set(PLUGINS_IN_PYTHON) <= set(stand_ins.plugin_names())
    folder = Path(mi.__file__).parent / "python" / "ad"
    text = "".join(path.read_text() for path in folder.rglob("*.py"))
    registered = {line.split('"')[1] for line in text.splitlines() if line.startswith("mi.register_")}
    assert set(PLUGINS_IN_PYTHON) == registered


@compiled
def test_image_equals_render(tmp_path, tmp_path_factory, variant_rgb, mitsuba):
    """Two of our plugins and a bitmap in a folder of their own: the same pixels as mi.render, to the half. Modules that
    lie beside the scene are not imported.
    """
    wood = np.tile(np.linspace(0, 255, 8).astype(np.uint8)[:, None, None], (1, 8, 3))
    mi.Bitmap(wood).write(str(tmp_path / "wood.png"))
    scene, here = write(tmp_path, "wood.xml", inside=BITMAP), tmp_path_factory.mktemp("here")
    for folder in tmp_path, here:
        (folder / "numpy.py").write_text("raise SystemExit(7)")
    done = mitsuba(here, "-m", "llvm_ad_rgb", "-D", "radiance=2", scene)
    assert done.returncode == 0, done.stderr
    image = pixels(tmp_path / "wood.exr")
    reference = np.array(mi.render(mi.load_file(str(scene), parallel=False, radiance="2")))
    assert image.dtype == np.float16 and np.ptp(image) > 0.1
    assert np.array_equal(image, reference.astype(np.float16))


@pytest.mark.slow
@compiled
def test_search_path_and_one_thread(tmp_path, variant_rgb, mitsuba):
    """The current folder, then those of -a in their order, then the scene's. With -t 1 Mitsuba 3.9.1 alone hangs when
    it writes an EXR.
    """
    (tmp_path / "scene").mkdir()
    scene = write(tmp_path / "scene", "scene.xml", inside=BITMAP.replace("wood.png", "grey.exr"))
    arguments = ["-t", "1", "-a", f"{tmp_path / 'a'};{tmp_path / 'b'}", "-o", tmp_path / "out.png", scene]
    for folder, value in ("scene", 0.1), ("b", 0.2), ("a", 0.4), ("here", 0.8):
        (tmp_path / folder).mkdir(exist_ok=True)
        grey = np.full((4, 4, 3), value, dtype=np.float32)
        OpenEXR.File({}, {"RGB": grey}).write(str(tmp_path / folder / "grey.exr"))
        if folder in ("a", "here"):
            (tmp_path / "here").mkdir(exist_ok=True)
            assert mitsuba(tmp_path / "here", *arguments).returncode == 0
            image = pixels(tmp_path / "out.exr").astype(float)
            assert image[8, 12].mean() == pytest.approx(0.5 * value, rel=0.2)  # few samples, but a factor of two apart


INTEGRATORS = (
    '<integrator type="prosim"/>',
    '<integrator type="prosim"><integer name="diffuse_bounces" value="-1"/></integrator>',
    '<integrator type="prosim_adaptive"><integrator type="prosim"/></integrator>',
    '<integrator type="prosim_denoised"><integrator type="prosim"/></integrator>',
    '<integrator type="prosim_features"/>',
    '<integrator type="aov"><string name="aovs" value="n:sh_normal"/><integrator type="prosim"/></integrator>',
    '<integrator type="path"/>',
    '<integrator type="volpath"/>',
)
MATERIALS = ("composite", "conductor", "dielectric", "lambertian", "phong")


@pytest.mark.slow
@compiled
@pytest.mark.parametrize(
    "integrator, mode, threads",
    [(name, "scalar_rgb", 4) for name in INTEGRATORS]
    + [(INTEGRATORS[0], *how) for how in (("scalar_rgb", 1), ("scalar_spectral", 2), ("scalar_rgb", 16))],
)
def test_scalar_render_ends(tmp_path, mitsuba, integrator, mode, threads):
    """Threads of Mitsuba take the samples, while the thread that renders waits for them."""
    balls = [
        f"""<shape type="sphere"><point name="center" x="{x}" y="0" z="6"/><bsdf type="prosim_{name}"/></shape>"""
        for x, name in enumerate(MATERIALS, -2)
    ]
    (tmp_path / "scene.xml").write_text(scene_text(integrator, CONSTANT + "".join(balls)))
    done = mitsuba(tmp_path, "-m", mode, "-t", threads, "scene.xml")
    assert done.returncode == 0, done.stderr
    assert np.isfinite(pixels(tmp_path / "scene.exr")).all()


@pytest.mark.slow
@compiled
def test_mitsuba_command_renders_each_of_several_scenes_once(tmp_path, mitsuba):
    """A stock scene that the native command has rendered before it met ours is not rendered again."""
    stock = write(tmp_path, "stock.xml", "independent", "diffuse")
    ours, other = write(tmp_path, "ours.xml"), write(tmp_path, "other.xml", "multijitter", "diffuse")
    done = mitsuba(tmp_path, "-m", "llvm_ad_mono", stock, ours, other)
    assert done.returncode == 0, done.stderr
    for name in ("stock", "ours", "other"):
        assert done.stdout.count(f'{name}.exr" ..') == 1
        assert pixels(tmp_path / f"{name}.exr").shape[:2] == (16, 24)


@pytest.mark.slow
@compiled
def test_wrong_parameter(tmp_path, mitsuba):
    scene = write(tmp_path, "scene.xml", bsdf="prosim_conductor", inside='<string name="distribution" value="ggx"/>')
    done = mitsuba(tmp_path, scene)
    assert done.returncode == 255
    assert "Caught a critical exception" in done.stderr and "scene.xml (line 9, col 2)" in done.stderr
    assert "'ggx'; allowed: one of" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "scene.exr").exists()


@compiled
def test_python_starts_for_our_plugins_only(tmp_path, mitsuba):
    """From the interpreter that has them."""
    stock, ours = write(tmp_path, "stock.xml", "independent", "diffuse"), write(tmp_path, "ours.xml")
    done = mitsuba(tmp_path, stock, ours, MITSUBA_PYTHON="/nowhere")
    assert done.returncode == 255 and "MITSUBA_PYTHON" in done.stderr
    assert (tmp_path / "stock.exr").exists() and not (tmp_path / "ours.exr").exists()


#: A package with an entry point in the group ``mitsuba``; its plugin renders for a while.
OTHER = """if True:
    import os, time
    import mitsuba as mi

    def plugin(props):
        print("process", os.getpid(), flush=True)
        time.sleep(float(os.environ.get("SLEEP", 0)))
        return mi.load_dict({"type": "diffuse"})

    mi.register_bsdf("other_bsdf", plugin)
    """


@pytest.mark.slow
@compiled
def test_plugins_of_another_package_and_the_end_of_the_launcher(tmp_path, plugins, mitsuba):
    """The plugin has a stand-in in ./plugins, and is of a package with an entry point. A signal for the process that
    was started reaches the one that renders, its grandchild.
    """
    site, scene = tmp_path / "site", write(tmp_path, "scene.xml", "independent", "other_bsdf")
    (site / "other-1.dist-info").mkdir(parents=True)
    (site / "other-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1\n")
    (site / "other-1.dist-info" / "entry_points.txt").write_text("[mitsuba]\nother = other\n")
    (site / "other.py").write_text(OTHER)
    (tmp_path / "plugins").mkdir()
    shutil.copy(plugins / "nrook.so", tmp_path / "plugins" / "other_bsdf.so")
    assert mitsuba(tmp_path, scene).returncode == 255
    path = f"{site}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    done = mitsuba(tmp_path, scene, PYTHONPATH=path)
    assert done.returncode == 0 and (tmp_path / "scene.exr").exists(), done.stderr
    command, env = [COMMAND, "-m", "scalar_rgb", scene.name], os.environ | {"PYTHONPATH": path, "SLEEP": "1000"}
    with started(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=env) as launcher:
        renderer = next(int(line.split()[1]) for line in launcher.stdout if line.startswith("process"))
        assert renderer != launcher.pid
        launcher.terminate()
        launcher.communicate(timeout=PATIENCE)  # ends when both have
        assert launcher.returncode == -signal.SIGTERM


@pytest.mark.slow
@compiled
def test_ctrl_c_ends_at_once(tmp_path, plugins, monkeypatch):
    (tmp_path / "plugins").symlink_to(plugins)
    monkeypatch.chdir(tmp_path)
    scene = write(tmp_path, "scene.xml", width=512, height=512, spp=4096)
    program = Path(mi.__file__).with_name("mitsuba")
    with started([program, "-m", "scalar_rgb", scene], stdout=subprocess.PIPE) as process:
        next(line for line in process.stdout if b"Starting render job" in line)
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == -signal.SIGINT
    assert not (tmp_path / "scene.exr").exists()


def test_an_error_is_that_of_the_native_command(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(mi, "set_log_level", lambda _: None)
    (tmp_path / "scene.xml").write_text(scene_text(sampler="nrook"))
    missing = str(tmp_path / "missing")
    for arguments, says in [
        (("-m", "llvm_wrong"), "llvm_wrong"),
        (
            (f"{tmp_path}/scene.xml", "-m", "scalar_rgb", "-o", f"{missing}/a.exr"),
            f"{missing}: no image can be written",
        ),
    ]:
        assert hosted.main("nrook", *arguments) == 255
        error = capsys.readouterr().err
        assert "Caught a critical exception" in error and says in error
