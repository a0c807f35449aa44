"""Batch systems, as in the documentation: a cluster that Dask starts, and an array of parts. The same bytes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mitsuba_prosim.scene import scene_file
from running import LAMP, alike, done

PAGE = (Path(__file__).parents[2] / "docs" / "anywhere.md").read_text("utf-8")

pytestmark = pytest.mark.slow

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


def test_by_slurm(scene, variant_rgb, tmp_path, install):
    pytest.importorskip("dask_jobqueue", reason="dask_jobqueue.SLURMCluster is of dask-jobqueue")
    install(AT_ONCE)
    (code,) = re.findall(r"^```python\n([^`]*SLURMCluster\([^`]*)^```$", PAGE, re.MULTILINE)
    local = 'scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}'
    code = code.replace("cores=16", "cores=1").replace("jobs=20", "jobs=1").replace("palito.scn", scene.name)
    known = {}
    try:
        exec(code.replace("SLURMCluster(", f"SLURMCluster({local}, "), known)
        loaded = scene_file.SceneFile(scene, tmp_path).load()
        assert np.array_equal(np.array(known["image"]), np.array(loaded.integrator().render(loaded)))
    finally:
        if "cluster" in known:
            known["cluster"].close()


def test_the_array_of_the_documentation(scene, variant_rgb, install):
    """As its page has it, but for the scene and the number of parts."""
    install(IN_TURN)
    (script,) = re.findall(r"^cat > parts.sh <<'SCRIPT'\n.*?^sbatch parts.sh$", PAGE, re.MULTILINE | re.DOTALL)
    script = (
        script.replace("palito.scn", scene.name).replace("1-4", "1-2").replace("-of-4", "-of-2").replace("/4", "/2")
    )
    said = subprocess.run(["sh", "-c", script], check=True, capture_output=True, text=True).stdout
    assert re.findall(r"part (\d) of 2", said) == ["1", "2"]
    done("merge", *(f"night.{k}-of-2.npz" for k in (1, 2)), "-o", "night")
    done("render", scene, "-o", "whole")
    assert alike(Path("night"), Path("whole"))
