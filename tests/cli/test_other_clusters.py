"""Clusters that Dask begins by SSH and by batch systems, as the documentation has them: the same bytes."""

import asyncio
import os
import queue
import re
import signal
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.scene import scene_file
from running import prosim
from test_resume_and_merge import LAMP, alike

PAGE = (Path(__file__).parents[2] / "docs" / "anywhere.md").read_text("utf-8")


def recipe(name):
    """The code of the page that makes a cluster of this class, and its imports."""
    (code,) = re.findall(rf"^```python\n([^`]*{name}\([^`]*)^```$", PAGE, re.MULTILINE)
    return code


async def pass_on(said, to):
    while line := await said.readline():
        to.write(line.decode())


@contextmanager
def ssh_server(folder):
    """A server on this machine that runs what it is asked to; yields how one connects to it."""
    asyncssh = pytest.importorskip("asyncssh", reason="dask.distributed.SSHCluster needs asyncssh")
    host, user = (asyncssh.generate_private_key("ssh-ed25519") for _ in range(2))
    user.write_private_key(folder / "key")
    user.write_public_key(folder / "key.pub")
    known, ending = queue.Queue(), asyncio.Event()

    async def serve():
        running = []

        async def run(process):
            pipes = {"stdin": asyncio.subprocess.DEVNULL, "stdout": asyncio.subprocess.PIPE}
            pipes |= {"stderr": asyncio.subprocess.PIPE, "start_new_session": True}
            there = await asyncio.create_subprocess_shell(process.command, **pipes)
            running.append(there)
            with suppress(BrokenPipeError):  # the client has gone
                await asyncio.gather(pass_on(there.stdout, process.stdout), pass_on(there.stderr, process.stderr))
                process.exit(await there.wait())

        keys = {"server_host_keys": [host], "authorized_client_keys": str(folder / "key.pub")}
        server = await asyncssh.create_server(asyncssh.SSHServer, "127.0.0.1", 0, process_factory=run, **keys)
        known.put((server.get_port(), asyncio.get_running_loop()))
        await ending.wait()
        for there in running:
            if there.returncode is None:
                os.killpg(there.pid, signal.SIGTERM)
            await there.wait()
        server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    port, loop = known.get(timeout=10)
    try:
        yield {"port": port, "client_keys": [str(folder / "key")], "known_hosts": None}
    finally:
        loop.call_soon_threadsafe(ending.set)
        thread.join()


@pytest.fixture
def lamp(scene, variant_rgb, monkeypatch):
    scene.write_text(LAMP)
    monkeypatch.chdir(scene.parent)
    return scene


def run(code, lamp):
    """Runs it for another scene; whether the image has the bytes of one process, and so has that of the command."""
    known = {}
    try:
        exec(code.replace("palito.scn", lamp.name), known)
        assert np.array_equal(np.array(known["image"]), np.array(render(lamp)))
        done = prosim("render", lamp, "-o", "many", "--cluster", known["cluster"].scheduler_address)
        assert done.exit_code == 0, done.output
    finally:
        if "cluster" in known:
            known["cluster"].close()
    assert prosim("render", lamp, "-o", "one").exit_code == 0
    assert alike(Path("many"), Path("one"))


def render(path):
    """The image by this process alone."""
    with atomic.scratch() as folder:
        scene = scene_file.SceneFile(path, folder).load()
    return scene.integrator().render(scene)


@pytest.mark.slow
def test_by_ssh(lamp, tmp_path):
    with ssh_server(tmp_path) as options:
        code = recipe("SSHCluster").replace('["desk", "shelf", "cellar"]', '["127.0.0.1"] * 2')
        more = {"connect_options": options, "scheduler_options": {"port": 0, "dashboard_address": "127.0.0.1:0"}}
        run(code.replace('"nthreads": 8}', f'"nthreads": 1}}, **{more!r}'), lamp)


#: A batch system that begins each job at once.
SBATCH = """#!/bin/sh
cp "$1" "$0.$$"
setsid sh "$0.$$" > "$0.log" 2>&1 < /dev/null &
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
kill -- "-$1"
"""


@pytest.mark.slow
def test_by_slurm(lamp, tmp_path, monkeypatch):
    pytest.importorskip("dask_jobqueue", reason="dask_jobqueue.SLURMCluster is of dask-jobqueue")
    for name, text in [("sbatch", SBATCH), ("scancel", SCANCEL)]:
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path), os.environ["PATH"]]))
    code = recipe("SLURMCluster").replace("cores=16", "cores=1").replace("jobs=20", "jobs=1")
    here = 'scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}'
    run(code.replace("SLURMCluster(", f"SLURMCluster({here}, "), lamp)
