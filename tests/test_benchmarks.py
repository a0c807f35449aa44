"""The benchmarks run: small images, few rounds. Their figures are not judged here."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SMALL = ["--size", "24", "--rounds", "2", "--reference-seconds", "1"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "script, rows",
    [
        (["gains.py", "policies", "--scene", "penumbra", *SMALL], 2),
        (["gains.py", "denoised", "--scene", "Cornell box", *SMALL], 1),
        (["gains.py", "cycles", "--scene", "metal floor", *SMALL], 1),
        (["promises.py", "--scene", "penumbra", *SMALL], 2),
        (["materials.py", "--only", "phong", *SMALL], 1),
        (["convergence.py", "--scene", "24 lamps", *SMALL], 5),
        (["translator.py", "trees", "20", "--tree", "comb"], 1),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_a_table_is_printed(tmp_path, script, rows):
    folder = ["--output", str(tmp_path)] if script[0] == "convergence.py" else []
    cache = ["--cache", str(tmp_path)] if "--reference-seconds" in script else []
    command = [sys.executable, str(BENCHMARKS / script[0]), *script[1:], *cache, *folder]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    table = run.stdout.split("\n\n")[0].strip().splitlines()
    assert len(table) == 2 + rows, run.stdout
