"""``prosim render --cluster`` and ``--workers``: the same bytes, whoever takes the samples, and whoever is lost."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import dask
import drjit as dr
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim.cli import output_files as files
from mitsuba_prosim.engine import origin
from mitsuba_prosim.engine.checkpoint import CheckpointWriter
from mitsuba_prosim.parallel import cluster, worker
from mitsuba_prosim.parallel.bundle import SceneBundle
from mitsuba_prosim.parallel.executor import LOOK, ClusterError, DaskExecutor, render
from mitsuba_prosim.scene import images, scene_file, session
from running import names, prosim
from test_frames import FILM
from test_resume_and_merge import LAMP, alike

LAMP = LAMP.replace('"32"', '"64"').replace('"24"', '"48"')
NOISE = {"noise": 0.007, "max_samples": 400}


@pytest.fixture(scope="module")
def client():
    with cluster.workers(2) as client:
        yield client


@pytest.fixture
def lamp(scene, variant_rgb):
    scene.write_text(LAMP)
    return scene


def here(path, **changes):
    """The image by this process alone."""
    scene = scene_file.SceneFile(path, path.parent, **changes).load()
    return np.array(scene.integrator().render(scene, seed=2))


def there(client, path, tell=None, say=lambda _: None, **changes):
    """The image by a cluster; ``tell`` is called after each portion, with the part done."""
    file = scene_file.SceneFile(path, path.parent, **changes)
    scene = file.load()
    integrator = scene.integrator()
    render = integrator.progressive(scene, seed=2, executor=DaskExecutor(client, SceneBundle.of(file), say))
    for step in render:
        if tell is not None:
            tell(step.done)
    return np.array(render.image())


# ------------------------------------------------------------------ what travels


def test_a_scene_travels_with_the_files_that_it_names(lamp, tmp_path):
    picture = '<shape type="rectangle"><bsdf type="diffuse"><texture name="reflectance" type="bitmap">'
    picture += '<string name="filename" value="{}"/></texture></bsdf></shape></scene>'
    path, skin = tmp_path / "scene" / "lamp.xml", tmp_path / "scene" / "skins" / "a.png"
    skin.parent.mkdir(parents=True)
    skin.write_bytes(images.png(np.full((2, 2, 3), 0.5, np.float32)))
    path.write_text(LAMP.replace("</scene>", picture.format("skins/a.png")))
    bundle = SceneBundle.of(scene_file.SceneFile(path, tmp_path))
    assert set(bundle.contents) == {"lamp.xml", "skins/a.png"}
    moved = path.parent.rename(tmp_path / "moved")
    assert SceneBundle.of(scene_file.SceneFile(moved / "lamp.xml", tmp_path)).key == bundle.key
    assert SceneBundle.of(scene_file.SceneFile(moved / "lamp.xml", tmp_path), sensor=1).key != bundle.key
    assert len(bundle.load(bundle.contents)[0].shapes()) == 3
    (moved / "skins" / "a.png").rename(tmp_path / "a.png")
    for name in "../a.png", str(tmp_path / "moved" / "b.png"):
        (tmp_path / "moved" / "b.png").write_bytes((tmp_path / "a.png").read_bytes())
        (moved / "lamp.xml").write_text(LAMP.replace("</scene>", picture.format(name)))
        with pytest.raises(ValueError, match="needs all files in the scene's folder"):
            SceneBundle.of(scene_file.SceneFile(moved / "lamp.xml", tmp_path))


def test_so_do_files_that_are_named_by_paths_and_parameters(lamp, tmp_path):
    (tmp_path / "skins").mkdir()
    OpenEXR.File({}, {c: np.full((2, 2), 0.5, np.float32) for c in "RGB"}).write(str(tmp_path / "skins" / "a.7.exr"))
    texture = '<texture name="reflectance" type="bitmap"><string name="filename" value="a.$frame.exr"/></texture>'
    text = LAMP.replace("</scene>", f'<shape type="sphere"><bsdf type="diffuse">{texture}</bsdf></shape></scene>')
    text = text.replace('<rgb name="radiance" value="9"/>', '<spectrum name="radiance" filename="skins/$kind.spd"/>')
    lamp.write_text(text.replace("<sensor", '<path value="skins"/><default name="kind" value="lamp"/><sensor', 1))
    keys = []
    for line in "400 9\n700 9\n", "400 9\n700 8\n":
        (tmp_path / "skins" / "lamp.spd").write_text(line)
        bundle = SceneBundle.of(scene_file.SceneFile(lamp, tmp_path, definitions={"frame": "7"}))
        assert set(bundle.contents) == {"scene.xml", "skins/a.7.exr", "skins/lamp.spd"}
        keys.append(bundle.key)
    assert keys[0] != keys[1]
    (tmp_path / "skins").rename(tmp_path / "gone")
    assert len(bundle.load(bundle.contents)[0].shapes()) == 3


@pytest.mark.parametrize(
    "options, says",
    [
        (["--workers", 2, "--cluster", "tcp://a:1"], "give one of them"),
        (["--workers", 2, "--part", "1/2"], "leave it out with a cluster"),
        (["--cluster", "localhost"], "'localhost' is not of the form ADDRESS, such as tcp://machine:8786"),
        (["--workers", 2, "-m", "scalar_rgb"], "--workers: scalar_rgb"),
        (["--workers", 2], "needs prosim or prosim_adaptive"),
    ],
)
def test_wrong_use(scene, options, says):
    result = prosim("render", scene, *options)
    assert result.exit_code == 2 and says in result.stderr and names(scene.parent) == ["scene.xml"]


def test_workers_that_can_not_be_begun(lamp, monkeypatch):
    def fails(**_):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(cluster.distributed, "LocalCluster", fails)
    result = prosim("render", lamp, "--workers", 1)
    assert (
        result.exit_code == 1 and "Error: the workers can't be started here (Nanny failed to start.)" in result.output
    )


def test_without_the_package_nothing_is_begun(lamp, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = prosim("render", lamp, "--workers", 2)
    assert result.exit_code == 1 and "to get it: pip install 'mitsuba-prosim[cluster]'" in result.stderr
    assert names(lamp.parent) == [lamp.name]


def test_no_scheduler(lamp, monkeypatch):
    monkeypatch.setattr(cluster, "ANSWER", 0.2)
    result = prosim("render", lamp, "--cluster", "tcp://127.0.0.1:1")
    assert result.exit_code == 1 and "no scheduler answers at tcp://127.0.0.1:1" in result.stderr


@pytest.mark.slow
def test_ctrl_c_is_for_the_process_that_renders(client, lamp, monkeypatch):
    """Workers ignore it; before the first sample the command says that there is nothing."""
    workers = set(client.run(os.getpid).values())
    for process in workers:
        os.kill(process, signal.SIGINT)
    time.sleep(0.5)
    assert set(client.run(os.getpid).values()) == workers

    def pressing(address, scheduler=cluster.scheduler):
        os.kill(os.getpid(), signal.SIGINT)
        return scheduler(address)

    monkeypatch.setattr(cluster, "scheduler", pressing)
    result = prosim("render", lamp, "--cluster", client.scheduler.address)
    assert result.exit_code == 130 and "nothing was written" in result.output
    assert names(lamp.parent) == [lamp.name]


# ------------------------------------------------------------------ the same bytes


@pytest.mark.slow
def test_two_workers_make_the_same_image(client, lamp):
    for changes in ({}, {"integrator": {"adaptive": "graded"}, "crop": (9, 5, 32, 24)}):
        expected = here(lamp, **changes)
        assert np.array_equal(np.array(render(lamp, client=client, seed=2, **changes)), expected)


@pytest.mark.parametrize("address, more", [("inproc://127.0.0.1/1/2", 0), ("tcp://127.0.0.1:1", 2)])
def test_a_worker_in_the_process_of_its_client_leaves_it_its_threads(variant_rgb, address, more):
    threads = dr.thread_count()
    here = SimpleNamespace(address=address, state=SimpleNamespace(nthreads=threads + 2))
    with session.threads(None):
        assert asyncio.run(worker.check(variant_rgb, here)) == origin.here()
        assert dr.thread_count() == threads + more


#: Lets a worker forget its scenes.
FORGET = "from mitsuba_prosim.parallel import worker; worker.scenes.clear()"


def kill_one(client):
    """Kills a worker, and waits until everybody who looks has seen that it is there no more."""
    address, process = next(iter(client.run(os.getpid).items()))
    os.kill(process, signal.SIGKILL)
    while address in client.sync(client.scheduler.ncores):
        time.sleep(0.05)
    time.sleep(1.5 * LOOK)


@pytest.mark.slow
def test_workers_that_are_killed_and_scenes_that_are_forgotten(client, lamp):
    """Another takes the place of the one that was killed, as Dask's nanny begins it anew; and of one whose nanny has
    given up.
    """
    acts = [lambda: kill_one(client), lambda: client.run(exec, FORGET)]
    told = []

    def tell(done):
        told.append(done)
        if acts and len(told) % 2:
            acts.pop()()

    said = []
    image = there(client, lamp, tell, said.append, integrator=NOISE)
    assert len(said) == 1 and re.match("a worker was lost, (1|none) left; others", said[0])
    assert not acts and len(told) > 4 and np.array_equal(image, here(lamp, integrator=NOISE))
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}):
        gone = next(iter(client.cluster.workers.values()))
        client.cluster.sync(gone.close)
        client.wait_for_workers(2, timeout=20)
    assert gone not in client.cluster.workers.values()


@pytest.mark.slow
def test_values_that_are_lost_with_all_workers(client, lamp):
    """Each task has ended, and no value has arrived but the first."""
    acts = [lambda: [os.kill(process, signal.SIGKILL) for process in client.run(os.getpid).values()]]

    def tell(done):
        if acts and done:
            time.sleep(2)
            acts.pop()()

    assert np.array_equal(there(client, lamp, tell, integrator=NOISE), here(lamp, integrator=NOISE)) and not acts


#: A glass ball on a floor under a lamp; four sets of photons, for four samples of each pixel.
GLASS = """<scene version="3.0.0">
    <integrator type="prosim">
        <integer name="samples" value="2"/> <integer name="max_samples" value="16"/>
        <string name="adaptive" value="none"/>
        <boolean name="caustics" value="true"/> <integer name="caustic_photons" value="4096"/>
    </integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 4, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="48"/> <integer name="height" value="32"/> <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="6"/></transform>
        <bsdf type="prosim_lambertian"/>
    </shape>
    <shape type="sphere"><point name="center" x="0" y="1.2" z="0"/><bsdf type="dielectric"/></shape>
    <emitter type="prosim_point"><point name="position" x="-3" y="5" z="1"/></emitter>
</scene>"""


@pytest.mark.slow
def test_photons_are_the_same_if_a_worker_is_lost(client, scene, variant_rgb, monkeypatch):
    scene.write_text(GLASS)
    expected = here(scene)

    monkeypatch.setattr(DaskExecutor, "limit", lambda *_: 2000)
    client.run(exec, FORGET)
    assert np.array_equal(there(client, scene), expected)
    client.run(exec, FORGET)
    acts = [lambda: kill_one(client)]
    assert np.array_equal(there(client, scene, lambda _: acts and acts.pop()()), expected) and not acts


@pytest.mark.slow
def test_workers_of_another_kind(client, lamp, monkeypatch):
    ours = origin.here()
    said = []
    monkeypatch.setattr(origin, "here", lambda: ours | {"processor": "another"})
    assert np.array_equal(there(client, lamp, say=said.append), here(lamp))
    assert said and all(re.search("is of another kind .processor .* there, another here", text) for text in said)
    monkeypatch.setattr(origin, "here", lambda: ours | {"mitsuba": "3.0"})
    with pytest.raises(ClusterError, match=r"no worker of the cluster can take part: .*mitsuba 3\.9.* 3\.0 here"):
        there(client, lamp)


@pytest.mark.slow
def test_two_renders_on_one_cluster(client, lamp):
    options = ["render", lamp, "--adaptive", "graded", "--seed", "2", "-o"]
    command = [sys.executable, "-m", "prosim_start", *options, lamp.parent / "a"]
    with subprocess.Popen([*command, "--cluster", client.scheduler.address]) as process:
        image = there(client, lamp, integrator={"adaptive": "graded"})
        assert process.wait(100) == 0
    assert np.array_equal(image, here(lamp, integrator={"adaptive": "graded"}))
    assert prosim(*options, lamp.parent / "b").exit_code == 0
    assert alike(lamp.parent / "a", lamp.parent / "b")


@pytest.mark.slow
def test_a_film(client, lamp, monkeypatch):
    """Its frames have the bytes of one process, though the command is interrupted and a worker is lost."""
    film = lamp.with_name("film.scn")
    film.write_text(FILM)
    options = ["render", film, "--frames", "0:6", "--resolution", "12x12"]
    assert prosim(*options, "-o", film.with_name("a")).exit_code == 0
    saved, save = [], files.save

    def saving(stem, contents):
        saved.append(stem.name)
        if len(saved) == 2:  # the first frame is made by all workers, the others by one each
            os.kill(os.getpid(), signal.SIGINT)
        elif len(saved) == 4:
            kill_one(client)
        return save(stem, contents)

    monkeypatch.setattr(files, "save", saving)
    many = [*options, "-o", film.with_name("b"), "--cluster", client.scheduler.address]
    result = prosim(*many)
    assert result.exit_code == 1 and "2 of 6 frames rendered; interrupted" in result.stdout, result.output
    result = prosim(*many)
    assert result.exit_code == 0 and "4 of 6 frames rendered, 2 had been rendered before" in result.stdout
    assert len(set(saved)) == 6 and result.stderr.count("a worker was lost, 1 left") <= 1
    assert all(alike(film.with_name(f"b.000{n}.exr"), film.with_name(f"a.000{n}.exr")) for n in range(6))


#: A cluster in a process of its own, which says where it is.
ANOTHER = (
    "import time; from mitsuba_prosim.parallel import cluster\n"
    "with cluster.workers(1, 1) as client: print(client.scheduler.address, flush=True); time.sleep(100)"
)


@pytest.mark.slow
def test_a_scheduler_that_goes_away(lamp, monkeypatch):
    """The image so far is written, and its state, which goes on to the same bytes."""
    folder, keep = lamp.parent, CheckpointWriter.__call__
    aim = ["--noise", 0.01]
    with subprocess.Popen([sys.executable, "-c", ANOTHER], stdout=subprocess.PIPE, text=True) as process:

        def killing(self, render, last=False):
            if not last and render.counts().any():
                process.kill()
            keep(self, render, last)

        with monkeypatch.context() as patch:
            patch.setattr(CheckpointWriter, "__call__", killing)
            address = process.stdout.readline().strip()
            result = prosim("render", lamp, "--checkpoint", "-o", folder / "a", "--cluster", address, *aim)
    assert result.exit_code == 1 and re.search("the scheduler tcp://.* has gone away", result.output)
    assert f"prosim resume {folder / 'a.state.npz'}" in result.output
    assert prosim("resume", folder / "a.state.npz").exit_code == 0
    assert prosim("render", lamp, "-o", folder / "b", *aim).exit_code == 0
    assert alike(folder / "a", folder / "b")


#: Runs the tasks of an array one after the other.
SBATCH = """#!/bin/sh
for id in $(seq $(sed -n 's/^#SBATCH --array=\\([0-9]*\\)-\\([0-9]*\\)$/\\1 \\2/p' "$1")); do
    SLURM_ARRAY_TASK_ID=$id sh "$1" || exit 1
done
"""


@pytest.mark.slow
def test_the_array_of_the_documentation(lamp, monkeypatch):
    """As its page has it, but for the scene and the number of parts."""
    folder = lamp.parent
    page = (Path(__file__).parents[2] / "docs" / "anywhere.md").read_text("utf-8")
    (script,) = re.findall(r"^cat > parts.sh <<'SCRIPT'\n.*?^sbatch parts.sh$", page, re.MULTILINE | re.DOTALL)
    script = script.replace("palito.scn", lamp.name).replace("1-4", "1-2").replace("-of-4", "-of-2").replace("/4", "/2")
    (folder / "sbatch").write_text(SBATCH)
    (folder / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(folder), str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.chdir(folder)
    said = subprocess.run(["sh", "-c", script], check=True, capture_output=True, text=True).stdout
    assert re.findall(r"part (\d) of 2", said) == ["1", "2"]
    assert prosim("merge", *(f"night.{k}-of-2.npz" for k in (1, 2)), "-o", "night").exit_code == 0
    assert prosim("render", lamp, "-o", "whole").exit_code == 0
    assert alike(folder / "night", folder / "whole")
