"""The command ``mitsuba`` renders scenes that name our plugins after ``prosim link``, and is like the native one."""

import os
import signal
import subprocess

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from running import CONSTANT, pixels, scene_text
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


@pytest.fixture
def mitsuba(linked):
    """Runs the command in a folder."""

    def run(folder, *arguments, **env):
        how = {"cwd": folder, "env": os.environ | env, "capture_output": True, "text": True, "timeout": PATIENCE}
        return subprocess.run([linked, *map(str, arguments)], check=False, **how)

    return run


@pytest.mark.slow
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
@pytest.mark.parametrize(
    "number, mode, threads",
    [(len(INTEGRATORS), "scalar_rgb", 4), (1, "scalar_rgb", 1), (1, "scalar_spectral", 2), (1, "scalar_rgb", 16)],
)
def test_scalar_renders_end(tmp_path, mitsuba, number, mode, threads):
    """Threads of Mitsuba take the samples, while the thread that renders waits for them."""
    balls = [
        f"""<shape type="sphere"><point name="center" x="{x}" y="0" z="6"/><bsdf type="prosim_{name}"/></shape>"""
        for x, name in enumerate(MATERIALS, -2)
    ]
    scenes = [tmp_path / f"{k}.xml" for k in range(number)]
    for scene, integrator in zip(scenes, INTEGRATORS):
        scene.write_text(scene_text(integrator, CONSTANT + "".join(balls)))
    done = mitsuba(tmp_path, "-m", mode, "-t", threads, *scenes)
    assert done.returncode == 0, done.stderr
    assert all(np.isfinite(pixels(scene.with_suffix(".exr"))).all() for scene in scenes)


@pytest.mark.slow
def test_mitsuba_command_renders_several_scenes(tmp_path, mitsuba):
    """With and without plugins in Python."""
    stock, ours = write(tmp_path, "stock.xml", "independent", "diffuse"), write(tmp_path, "ours.xml")
    done = mitsuba(tmp_path, "-m", "llvm_ad_mono", stock, ours)
    assert done.returncode == 0, done.stderr
    for name in ("stock", "ours"):
        assert done.stdout.count(f'{name}.exr" ..') == 1
        assert pixels(tmp_path / f"{name}.exr").shape[:2] == (16, 24)


@pytest.mark.slow
def test_wrong_parameter(tmp_path, mitsuba):
    scene = write(tmp_path, "scene.xml", bsdf="prosim_conductor", inside='<string name="distribution" value="ggx"/>')
    done = mitsuba(tmp_path, scene)
    assert done.returncode == 255
    assert "Caught a critical exception" in done.stderr and "scene.xml (line 9, col 2)" in done.stderr
    assert "'ggx'; allowed: one of" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "scene.exr").exists()


@pytest.mark.slow
def test_native_program_does_all_else(tmp_path, mitsuba):
    """Its own scenes, also with options of the compiler, and help and errors."""
    stock, ours = write(tmp_path, "stock.xml", "independent", "diffuse"), write(tmp_path, "ours.xml")
    done = mitsuba(tmp_path, "-m", "llvm_ad_rgb", "-O", "3", stock)
    assert done.returncode == 0 and (tmp_path / "stock.exr").exists()
    assert "Usage: mitsuba [options]" in mitsuba(tmp_path, "-h").stdout
    for says, *arguments in (
        ("none.xml", "none.xml"),
        ("llvm_wrong", "-m", "llvm_wrong", ours),
        ("$a=1", "-D", "a=1", ours),
        ("expect key=value", "-D", "a", ours),
    ):
        error = mitsuba(tmp_path, *arguments).stderr
        assert "Caught a critical exception" in error and says in error
    refused = mitsuba(tmp_path, ours, "-O", "3")
    assert refused.returncode == 255 and "-O, -S, -V and -W do not work" in refused.stderr


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
def test_plugins_of_another_package_and_ctrl_c(tmp_path, mitsuba, linked):
    """The plugin is of a package with an entry point."""
    site, scene = tmp_path / "site", write(tmp_path, "scene.xml", "independent", "other_bsdf")
    (site / "other-1.dist-info").mkdir(parents=True)
    (site / "other-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1\n")
    (site / "other-1.dist-info" / "entry_points.txt").write_text("[mitsuba]\nother = other\n")
    (site / "other.py").write_text(OTHER)
    assert mitsuba(tmp_path, scene).returncode == 255
    env = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = mitsuba(tmp_path, scene, **env)
    assert done.returncode == 0 and (tmp_path / "scene.exr").exists(), done.stderr
    (tmp_path / "scene.exr").unlink()
    command = [linked, "-m", "scalar_rgb", scene.name]
    with started(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=env | {"SLEEP": "1000"}) as process:
        next(line for line in process.stdout if line.startswith("process"))
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == -signal.SIGINT
    assert not (tmp_path / "scene.exr").exists()


@pytest.mark.slow
def test_an_error_is_that_of_the_native_command(tmp_path, mitsuba):
    done = mitsuba(tmp_path, write(tmp_path, "scene.xml"), "-o", "missing/a.exr")
    assert done.returncode == 255 and "Caught a critical exception: missing: no image can be written" in done.stderr
