"""``prosim render --cluster`` and ``--workers``: the same bytes, whoever takes the samples, and whoever is lost.

Batch systems, as in the documentation: a cluster that Dask starts, and an array of parts.
"""

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from unittest import mock
from urllib.parse import urlsplit

import dask
import distributed
import numpy as np
import OpenEXR
import psutil
import pytest
from mitsuba_prosim.engine import environment
from mitsuba_prosim.engine.checkpoint import CheckpointWriter
from mitsuba_prosim.parallel import cluster, executor, worker
from mitsuba_prosim.parallel.executor import CHECK_INTERVAL, ClusterError, DaskExecutor
from mitsuba_prosim.parallel.worker import SceneBundle
from mitsuba_prosim.scene import scene_file
from running import ADAPTIVE_PATH, LIT_FLOOR, alike, done, prosim, refused, scene_text
from test_samples_per_pixel import INTEGRATORS, SPP
from waiting import PATIENCE, started, until

PAGE = (Path(__file__).parents[2] / "docs" / "anywhere.md").read_text("utf-8")
LAMP = scene_text(ADAPTIVE_PATH, LIT_FLOOR, 64, 48)
NOISE = {"noise": 0.007, "max_samples": 400}


@pytest.fixture(scope="module")
def client():
    """Its certificate is in Dask's configuration, so that ``--cluster`` can use it."""
    with cluster.workers(2) as client:
        tls = client.security.get_tls_config_for_role("client")
        names = {"ca_file": "ca-file", "cert": "client.cert", "key": "client.key"}
        with dask.config.set({f"distributed.comm.tls.{name}": tls[key] for key, name in names.items()}):
            yield client


@pytest.fixture
def lamp(scene, variant_rgb):
    scene.write_text(LAMP)
    return scene


def here(path, **changes):
    """The image by this process alone."""
    scene = scene_file.SceneFile(path, path.parent, **changes).load()
    return np.array(scene.integrator().render(scene, seed=2))


def there(client, path, tell=None, spp=0, **changes):
    """The image by a cluster; ``tell`` is called after each portion, with the part done."""
    file = scene_file.SceneFile(path, path.parent, **changes)
    scene = file.load()
    integrator = scene.integrator()
    render = integrator.progressive(scene, seed=2, spp=spp, executor=DaskExecutor(client, SceneBundle.of(file)))
    for step in render:
        if tell is not None:
            tell(step.done)
    return np.array(render.image())


# ------------------------------------------------------------------ what travels


def test_a_scene_travels_with_the_files_that_it_names(lamp, tmp_path):
    """Also by search paths and parameters; wherever they are, but in its folder."""
    folder = tmp_path / "scene"
    for name in "skins", "unused":
        (folder / name).mkdir(parents=True)
    path = lamp.rename(folder / "scene.xml")
    texture = '<texture name="reflectance" type="bitmap"><string name="filename" value="{}"/></texture>'
    shape = f'<shape type="sphere"><bsdf type="diffuse">{texture}</bsdf></shape></scene>'
    text = LAMP.replace('<rgb name="radiance" value="9"/>', '<spectrum name="radiance" filename="skins/$kind.spd"/>')
    paths = '<path value="unused"/><path value="skins"/><default name="kind" value="lamp"/>'
    text = text.replace("<sensor", f"{paths}<sensor", 1)

    def bundle(name="a.$frame.exr", **how):
        path.write_text(text.replace("</scene>", shape.format(name)))
        definitions = {"frame": "7"} if "$frame" in name else {}
        return SceneBundle.of(scene_file.SceneFile(path, tmp_path, definitions=definitions), **how)

    OpenEXR.File({}, {c: np.full((2, 2), 0.5, np.float32) for c in "RGB"}).write(str(folder / "skins" / "a.7.exr"))
    (folder / "skins" / "lamp.spd").write_text("400 9\n700 9\n")
    first = bundle()
    files = {"scene.xml", "skins/a.7.exr", "skins/lamp.spd"}
    assert files == {name for name, content in first.contents.items() if content}
    path = folder.rename(tmp_path / "moved") / "scene.xml"
    assert bundle() == first != bundle(sensor=1)
    (path.parent / "skins" / "lamp.spd").write_text("400 9\n700 8\n")
    assert bundle() != first
    picture = (path.parent / "skins" / "a.7.exr").rename(tmp_path / "a.exr")
    assert len(first.load()[0].shapes()) == 3
    for name in "../a.exr", str(picture):
        with pytest.raises(ValueError, match="needs all files in the scene's folder"):
            bundle(name)
    text = text.replace('"unused"', '".."')  # an element <path>
    with pytest.raises(ValueError, match=r"the scene names \.\., and"):
        bundle()


@pytest.mark.slow
def test_other_process_cannot_use_local_workers(client):
    """It finds the open ports, and tries connections with another certificate, without TLS, and HTTP."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    ports = {c.laddr.port for one in family for c in one.net_connections("tcp") if c.status == psutil.CONN_LISTEN}
    assert urlsplit(client.scheduler.address).port in ports and len(ports) >= 6  # scheduler, workers, their HTTP
    script = """import sys, distributed
address, security = sys.argv[1], distributed.Security.temporary() if sys.argv[1].startswith("tls") else None
try:
    print("REACHED", distributed.Client(address, security=security, timeout="3s").submit(abs, -1).result(3))
except Exception as error:
    print(type(error).__name__)
"""
    for address in (client.scheduler.address, client.scheduler.address.replace("tls", "tcp")):
        said = subprocess.check_output([sys.executable, "-c", script, address], text=True, timeout=PATIENCE)
        assert said and "REACHED" not in said, said
    for port in ports:
        for path in "/", "/info/main/workers.html", "/json/identity.json", "/metrics", "/health", "/api/v1/get_workers":
            with suppress(OSError, http.client.HTTPException):
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=2)
                connection.request("GET", path)
                assert connection.getresponse().status in (302, 404), (port, path)  # "/" leads to a page that lacks
    assert client.submit(abs, -1).result() == 1


@pytest.mark.slow
def test_without_workers_nothing_is_begun(lamp, monkeypatch):
    """Where they can't be started in three attempts, where the package lacks, and where no scheduler answers, not even
    at a port that another program has.
    """
    fails = mock.Mock(side_effect=RuntimeError("Nanny failed to start."))
    monkeypatch.setattr(cluster, "TIMEOUT", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        for place in "tcp://127.0.0.1:1", "tls://127.0.0.1:1", f"tcp://127.0.0.1:{silent.getsockname()[1]}":
            refused(f"no scheduler answers at {place}", "render", lamp, "--cluster", place, code=1)
    monkeypatch.setattr(cluster.distributed, "LocalCluster", fails)
    refused("the workers can't be started here (Nanny failed to start.)", "render", lamp, "--workers", 1, code=1)
    assert fails.call_count == 3  # a worker may be lost at its start
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused("to get it: pip install 'mitsuba-prosim[cluster]'", "render", lamp, "--workers", 2, code=1)


@pytest.mark.slow
@pytest.mark.parametrize("killed", [False, True])
def test_workers_leave_no_temporary_file(lamp, tmp_path, killed):
    """Neither at the end nor when the process is killed."""
    (folder := tmp_path / "tmp").mkdir()
    command = [sys.executable, "-m", "prosim_start", "render", lamp, "--workers", "2", *["--noise", "1e-9"] * killed]
    with started(command, env=os.environ | {"TMPDIR": str(folder)}) as process:
        if killed:
            until(lambda: any(folder.glob("*/dask-scratch-space/worker-*")))
            process.kill()
        process.wait(PATIENCE)
    assert process.returncode == (-signal.SIGKILL if killed else 0)
    until(lambda: not os.listdir(folder))


@pytest.mark.slow
def test_ctrl_c_is_for_the_process_that_renders(client, lamp, monkeypatch):
    """Workers ignore it; before the first sample the command says that there is nothing."""
    workers = set(client.run(os.getpid).values())
    for process in workers:
        os.kill(process, signal.SIGINT)
        os.kill(process, signal.SIGHUP)
    time.sleep(0.5)
    assert set(client.run(os.getpid).values()) == workers

    def pressing(address, scheduler=cluster.scheduler):
        os.kill(os.getpid(), signal.SIGINT)
        return scheduler(address)

    monkeypatch.setattr(cluster, "scheduler", pressing)
    refused("nothing was written", "render", lamp, "--cluster", client.scheduler.address, code=130)


# ------------------------------------------------------------------ the same bytes


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATORS[1::3])
def test_workers_take_the_samples(scene, variant_rgb, counts, client, integrator):
    scene.write_text(scene_text(integrator, LIT_FLOOR))
    there(client, scene, spp=SPP)
    assert np.all(counts() == SPP)


@pytest.mark.slow
def test_by_threads_of_this_process(lamp, monkeypatch):
    """A work item that fails three times ends the render with its error."""
    with distributed.Client(processes=False, n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        changes = {"integrator": NOISE, "crop": (9, 5, 16, 12)}
        assert np.array_equal(there(client, lamp, **changes), here(lamp, **changes))
        monkeypatch.setattr(worker, "timed_sums", lambda *_: 1 / 0)
        with pytest.raises(ClusterError, match="3 attempts failed, the last one with: division by zero"):
            there(client, lamp)


#: Lets a worker forget its scenes.
FORGET = "from mitsuba_prosim.parallel import worker; worker.scenes.clear()"


def kill_one(client):
    """Kills a worker, and waits until everybody who looks has seen that it is there no more."""
    address, process = next(iter(client.run(os.getpid).items()))
    os.kill(process, signal.SIGKILL)
    until(lambda: address not in client.sync(client.scheduler.ncores))
    time.sleep(1.5 * CHECK_INTERVAL)


@pytest.mark.slow
def test_lost_workers_do_not_change_the_image(client, lamp):
    """Another takes the place of the one that was killed, as Dask's nanny starts it again; and of one whose nanny has
    given up. All are killed when each task has ended, and no value has arrived but the first.
    """

    def kill_all():
        time.sleep(2)
        for process in client.run(os.getpid).values():
            os.kill(process, signal.SIGKILL)

    told, acts = [], [kill_all, lambda: client.run(exec, FORGET), lambda: kill_one(client)]

    def tell(done):
        told.append(done)
        if acts and done:
            acts.pop()()

    with pytest.warns(UserWarning, match="a worker was lost, (1|none) left; others"):
        image = there(client, lamp, tell, integrator=NOISE)
    assert not acts and len(told) > 4 and np.array_equal(image, here(lamp, integrator=NOISE))
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}):
        gone = next(iter(client.cluster.workers.values()))
        client.cluster.sync(gone.close)
        client.wait_for_workers(2, timeout=PATIENCE)
    assert gone not in client.cluster.workers.values()


@pytest.mark.slow
def test_workers_of_another_kind(client, lamp, monkeypatch):
    ours = environment.this_environment()
    monkeypatch.setattr(environment, "this_environment", lambda: ours | {"processor": "another"})
    with pytest.warns(UserWarning, match="is of another kind .processor .* there, another here"):
        image = there(client, lamp)
    assert np.array_equal(image, here(lamp))
    monkeypatch.setattr(environment, "this_environment", lambda: ours | {"mitsuba": "3.0"})
    with pytest.raises(ClusterError, match=r"a worker of the cluster can.t take part: mitsuba 3\.9.* 3\.0 here"):
        there(client, lamp)


@pytest.mark.slow
def test_two_renders_on_one_cluster(client, lamp):
    options = ["render", lamp, "--adaptive", "graded", "--seed", "2", "-o"]
    command = [sys.executable, "-m", "prosim_start", *options, lamp.parent / "a"]
    crop = {"integrator": {"adaptive": "graded"}, "crop": (9, 5, 32, 24)}
    environ = os.environ | {"DASK_INTERNAL_INHERIT_CONFIG": dask.config.serialize(dask.config.config)}
    with started([*command, "--cluster", client.scheduler.address], env=environ) as process:
        image = there(client, lamp, **crop)
        assert process.wait(PATIENCE) == 0
    assert np.array_equal(image, here(lamp, **crop))
    done(*options, lamp.parent / "b")
    assert alike(lamp.parent / "a", lamp.parent / "b")


#: A cluster in a process of its own, which says where it is.
ANOTHER = (
    "import time, distributed\n"
    "how = {'n_workers': 1, 'threads_per_worker': 1, 'host': '127.0.0.1', 'dashboard_address': '127.0.0.1:0'}\n"
    "with distributed.LocalCluster(**how) as made: print(made.scheduler_address, flush=True); time.sleep(1000)"
)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_lost_scheduler_keeps_the_image_so_far(lamp, monkeypatch, number):
    """The image so far is written, and its state, which goes on to the same bytes. So too if it does not answer."""
    folder, keep = lamp.parent, CheckpointWriter.__call__
    aim = ["--noise", 0.01]
    with started([sys.executable, "-c", ANOTHER], stdout=subprocess.PIPE, text=True) as process:

        def killing(self, render):
            if render.counts().any():
                process.send_signal(number)
            keep(self, render)

        with monkeypatch.context() as patch:
            patch.setattr(CheckpointWriter, "__call__", killing)
            patch.setattr(executor, "ANSWER", 2)
            address = process.stdout.readline().strip()
            result = prosim("render", lamp, "--checkpoint", "-o", folder / "a", "--cluster", address, *aim)
    assert result.exit_code == 1 and re.search("the scheduler tcp://.* has gone away", result.output)
    assert f"prosim resume {folder / 'a.state.npz'}" in result.output
    done("resume", folder / "a.state.npz")
    done("render", lamp, "-o", folder / "b", *aim)
    assert alike(folder / "a", folder / "b")


# ------------------------------------------------------------------ batch systems


#: Commands of a batch system that starts each job at once.
AT_ONCE = {
    "sbatch": """#!/bin/sh
cp "$1" "$0.$$"
setsid sh "$0.$$" > "$0.log" 2>&1 < /dev/null &
echo "Submitted batch job $!"
""",
    "scancel": """#!/bin/sh
kill -- "-$1"
""",
}
#: Runs the tasks of an array one after the other.
IN_TURN = {
    "sbatch": """#!/bin/sh
for id in $(seq $(sed -n 's/^#SBATCH --array=\\([0-9]*\\)-\\([0-9]*\\)$/\\1 \\2/p' "$1")); do
    SLURM_ARRAY_TASK_ID=$id sh "$1" || exit 1
done
"""
}


@pytest.fixture
def install(scene, monkeypatch):
    """Puts commands of a batch system into the current folder, which has a scene, and is searched for commands."""
    scene.write_text(LAMP)
    monkeypatch.chdir(scene.parent)
    path = [str(scene.parent), str(Path(sys.executable).parent), os.environ["PATH"]]
    monkeypatch.setenv("PATH", os.pathsep.join(path))

    def written(commands):
        for name, text in commands.items():
            Path(name).write_text(text)
            Path(name).chmod(0o755)

    return written


@pytest.mark.slow
def test_by_slurm(scene, variant_rgb, install):
    pytest.importorskip("dask_jobqueue", reason="dask_jobqueue.SLURMCluster is of dask-jobqueue")
    install(AT_ONCE)
    (code,) = re.findall(r"^```python\n([^`]*SLURMCluster\([^`]*)^```$", PAGE, re.MULTILINE)
    local = 'scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}'
    code = code.replace("cores=16", "cores=1").replace("jobs=20", "jobs=1").replace("palito.scn", scene.name)
    known = {}
    try:
        exec(code.replace("SLURMCluster(", f"SLURMCluster({local}, "), known)
        done("render", scene, "-o", "whole")
        assert alike(scene, Path("whole"))
    finally:
        if "cluster" in known:
            known["cluster"].close()


@pytest.mark.slow
def test_the_array_of_the_documentation(scene, variant_rgb, install):
    """As its page has it, but for the scene and the number of parts."""
    install(IN_TURN)
    (script,) = re.findall(r"^cat > parts.sh <<'SCRIPT'\n.*?^sbatch parts.sh$", PAGE, re.MULTILINE | re.DOTALL)
    for old, new in ("palito.scn", scene.name), ("1-4", "1-2"), ("-of-4", "-of-2"), ("/4", "/2"):
        script = script.replace(old, new)
    said = subprocess.run(["sh", "-c", script], check=True, capture_output=True, text=True).stdout
    assert re.findall(r"part (\d) of 2", said) == ["1", "2"]
    done("merge", *(f"night.{k}-of-2.npz" for k in (1, 2)), "-o", "night")
    done("render", scene, "-o", "whole")
    assert alike(Path("night"), Path("whole"))
