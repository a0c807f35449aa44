"""``prosim render``: what its options do, and what it says of those that can't be."""

import re

import OpenEXR
import prosim_scene
import pytest
from mitsuba_prosim.cli import render
from mitsuba_prosim.cli.job import job_of
from mitsuba_prosim.scene import rendering, scene_file, session
from running import XML, names, prosim
from tqdm.auto import tqdm


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--resolution", "40"], "not of the form WxH, such as 640x480"),
        (["--noise", "60%"], "'60%' is not a number; write 0.6"),
        (["--noise", "0,01"], "'0,01' is not a number; write 0.01"),
        (["--noise", "little"], "'little' is not a number, such as 0.01"),
        (["--exposre", "1"], "'--exposure'"),
        (["--spp", "many"], "'many' is not a whole number"),
        (["--resolution", "0x4"], "1 to 65536 pixels a side"),
        (["--resolution", "99999999x99999999"], "1 to 65536 pixels a side"),
        (["--resolution", "65536x65536"], "268 million in all"),
        (["--crop", "1,2,3"], "not of the form X,Y,W,H"),
        (["--crop", "0,0,0,0"], "1 or more"),
        (["--crop", "-1,0,1,1"], "0 or more"),
        (["--crop", "0,0,100,100"], "a crop window of 100 x 100 pixels at (0, 0) leaves the image of 12 x 8"),
        (["-D", "key"], "key=value"),
        (["-m", "no_such_variant"], "llvm_ad_rgb"),
        (["--spp", "0"], "spp"),
        (["--spp", "4", "--samples", "2"], "give one of them"),
        (["-s", "7"], "out of bounds! The scene has one sensor, number 0."),
        (["--exposure", "1e9"], "range"),
        (["--exposure", "nan"], "finite"),
        (["--tolerance", "nan"], "finite"),
        (["-t", "100000"], "range"),
        (["--threshold", "-1"], "range"),
        (["--max-level", "-2"], "range"),
        (["--threshold", "0.1"], "prosim and prosim_adaptive have threshold; this scene's is path"),
        (["--samples", "2"], "prosim and prosim_adaptive have samples"),
        (["--paths"], "only the integrator prosim"),
        (["--samples", "5000"], "range"),
        (["--noise", "0"], "range"),
        (["--noise", "nan"], "finite"),
        (["--time", "-1"], "range"),
        (["--max-samples", "0"], "range"),
        (["--adaptive", "all"], "graded"),
        (["--noise", "0.1", "--adaptive", "thesis"], "knows neither --noise nor --time"),
        (["--noise", "0.1", "-m", "scalar_rgb"], "--noise: scalar_rgb finishes one pixel after the other"),
        (["--max-samples", "4", "-m", "scalar_rgb"], "--max-samples: scalar_rgb"),
        (["--light-units", "radiance"], "--light-units is for scenes in the thesis's language"),
        (["--tolerance", "1"], "--tolerance is for"),
        (["--allow-outside"], "is XML. It may name any file without that option."),
    ],
)
def test_wrong_use(scene, arguments, says):
    done = prosim("render", scene, *arguments)
    assert done.exit_code == 2, done.output
    assert says in done.stderr and "Traceback" not in done.output
    assert names(scene.parent) == ["scene.xml"]


def test_resolution_of_a_scene_that_no_film_can_hold(palito):
    palito.write_text(re.sub(r"RESOLUTION\W*\d+ \d+", "RESOLUTION: 65536 65536", palito.read_text()))
    done = prosim("render", palito, "--tolerance", 1000)
    assert done.exit_code == 2 and "too many pixels" in done.stderr


@pytest.mark.parametrize("level", [-1, 25])
def test_levels_that_only_paths_have(palito, level):
    done = prosim("render", palito, "--max-level", level)
    assert done.exit_code == 2 and "scratch" not in done.stderr
    assert f"the maximum depth is {level}; a tree of rays allows 0 to 24" in done.stderr
    assert "--paths" in done.stderr


def test_a_variant_that_this_machine_cannot_run(scene, monkeypatch):
    monkeypatch.setattr(session, "has_backend", lambda variant: not variant.startswith("cuda"))
    done = prosim("render", scene, "-m", "cuda_ad_rgb")
    assert done.exit_code == 1 and "needs an NVIDIA GPU" in done.stderr and "llvm_ad_rgb" in done.stderr


def test_memory_that_is_not_there(scene, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("jit_malloc(): out of memory!")

    monkeypatch.setattr(rendering, "progressive", fail)
    done = prosim("render", scene)
    assert done.exit_code == 1 and "could not be rendered: jit_malloc(): out of memory!" in done.stderr


@pytest.mark.parametrize("suffix", [".scn", ".xml"])
def test_parameters_of_the_integrator(palito, tmp_path, variant_rgb, suffix):
    """Those that the options ask for stand in what the integrator says of itself."""
    scene = palito if suffix == ".scn" else prosim_scene.translate(palito)
    for asked, samples, said in [
        ({"paths": True}, None, ["diffuse_bounces = -1", "max_level = -1"]),
        (
            {"paths": True, "max_level": 2, "threshold": 0.5},
            2,
            ["diffuse_bounces = -1", "max_level = 2", "threshold = 0.5", "samples = 2"],
        ),
        ({"max_level": 0}, None, ["diffuse_bounces = 0", "max_level = 0"]),
    ]:
        loaded = scene_file.SceneFile(
            scene, tmp_path / "out", samples=samples, integrator=job_of(dict(asked)).integrator
        ).load()
        assert [text for text in said if text not in str(loaded.integrator())] == []
        assert (loaded.integrator().ambient is None) == ("paths" in asked)


@pytest.mark.parametrize("said", ["", "CAUSTICS TRUE\n"])
@pytest.mark.parametrize("asked", [None, True, False])
def test_the_command_goes_before_the_scene_in_caustics(palito, tmp_path, variant_rgb, said, asked):
    palito.write_text(said + palito.read_text(encoding="utf-8"), encoding="utf-8")
    loaded = scene_file.SceneFile(palito, tmp_path / "out", integrator=job_of({"caustics": asked}).integrator).load()
    assert loaded.integrator().caustics is (bool(said) if asked is None else asked)


def test_caustics_are_asked_for_or_left_out_in_a_word(scene, monkeypatch):
    jobs = []
    monkeypatch.setattr(render, "write_image", lambda job, *_, **__: jobs.append(dict(job.integrator)))
    for option in ([], ["--caustics"], ["--no-caustics"]):
        assert prosim("render", scene, *option).exit_code == 0
    assert jobs == [{}, {"caustics": True}, {"caustics": False}]


@pytest.mark.slow
def test_paths_are_rendered(palito):
    done = prosim("render", palito, "--resolution", "8x8", "--samples", 1, "--paths")
    assert done.exit_code == 0, done.output
    header = OpenEXR.File(str(palito.with_suffix(".exr")), header_only=True).header()
    assert "diffuse_bounces = -1" in header["prosim.integrator"]


def test_a_fraction_for_a_whole_number_is_no_traceback(scene):
    scene.write_text(XML.replace('"path"/>', '"prosim"><float name="samples" value="2"/></integrator>'))
    done = prosim("render", scene)
    assert done.exception is None or isinstance(done.exception, SystemExit)
    assert done.exit_code in (0, 2) and "Traceback" not in done.output


@pytest.mark.parametrize(
    "size, distorts", [((16, 8), True), ((16, 16), False), ((17, 16), False), ((504, 500), False), ((510, 500), True)]
)
def test_a_resolution_that_distorts_is_said(palito, tmp_path, variant_rgb, recwarn, size, distorts):
    """palito's window is a square."""
    scene_file.SceneFile(palito, tmp_path / "out", resolution=size)
    assert any(f"{size[0]}x{size[0]} or {size[1]}x{size[1]} would not" in str(w.message) for w in recwarn) == distorts


def test_opening_reads_a_scene_once(palito, tmp_path, variant_rgb, monkeypatch):
    reads = []
    read = scene_file.prosim_scene.translator.read
    monkeypatch.setattr(scene_file.prosim_scene.translator, "read", lambda path: reads.append(path) or read(path))
    scene_file.SceneFile(palito, tmp_path, resolution=(8, 8)).load()
    assert reads == [palito]


def test_what_is_going_on_is_said_from_the_beginning(scene, monkeypatch):
    """On a terminal there is a word before the first step, while kernels are compiled."""
    words = []

    class Bar(tqdm):
        def __init__(self, desc, **more):
            words.append(desc)
            super().__init__(desc=desc, **more)

        def set_description_str(self, text, refresh=True):
            words.append(text)
            super().set_description_str(text, refresh)

    monkeypatch.setattr("mitsuba_prosim.cli.progress.tqdm", Bar)
    scene.write_text(XML.replace('"path"/>', '"prosim"><integer name="samples" value="2"/></integrator>'))
    assert prosim("render", scene).exit_code == 0
    assert words[0] == "compiling kernels" and set(words[1:]) == {"rendering"}
