"""A cluster that Dask starts through a batch system, as in the documentation: the same bytes."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from mitsuba_prosim.scene import scene_file
from running import prosim
from test_resume_and_merge import LAMP, alike

PAGE = (Path(__file__).parents[2] / "docs" / "anywhere.md").read_text("utf-8")

#: Commands of a batch system that starts each job at once.
COMMANDS = {
    "sbatch": """#!/bin/sh
cp "$1" "$0.$$"
setsid sh "$0.$$" > "$0.log" 2>&1 < /dev/null &
echo "Submitted batch job $!"
""",
    "scancel": """#!/bin/sh
kill -- "-$1"
""",
}


@pytest.mark.slow
def test_by_slurm(scene, variant_rgb, tmp_path, monkeypatch):
    pytest.importorskip("dask_jobqueue", reason="dask_jobqueue.SLURMCluster is of dask-jobqueue")
    scene.write_text(LAMP)
    monkeypatch.chdir(scene.parent)
    for name, text in COMMANDS.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path), os.environ["PATH"]]))
    (code,) = re.findall(r"^```python\n([^`]*SLURMCluster\([^`]*)^```$", PAGE, re.MULTILINE)
    local = 'scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}'
    code = code.replace("cores=16", "cores=1").replace("jobs=20", "jobs=1").replace("palito.scn", scene.name)
    known = {}
    try:
        exec(code.replace("SLURMCluster(", f"SLURMCluster({local}, "), known)
        loaded = scene_file.SceneFile(scene, tmp_path).load()
        assert np.array_equal(np.array(known["image"]), np.array(loaded.integrator().render(loaded)))
        done = prosim("render", scene, "-o", "many", "--cluster", known["cluster"].scheduler_address)
        assert done.exit_code == 0, done.output
    finally:
        if "cluster" in known:
            known["cluster"].close()
    assert prosim("render", scene, "-o", "one").exit_code == 0
    assert alike(Path("many"), Path("one"))
