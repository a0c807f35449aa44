"""The quick tests pass with the oldest packages that pyproject.toml admits, and with each Mitsuba, each for itself."""

import os
import subprocess
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OLDEST = ("mitsuba==3.9.0", 'numpy==1.26.*; python_version < "3.13"', "lark==1.2.*")
#: What the tests import, without mitsuba-oidn, which is built for the Dr.Jit of Mitsuba 3.9.1.
WITHOUT_DENOISING = (
    f"{ROOT}[cluster,compare,editors,tev,watch]",
    *("hatchling", "ipykernel", "ipywidgets", "nbclient", "playwright"),
    *("pytest", "pytest-lsp", "pytest-xdist", "scipy"),
)


@pytest.mark.versions
@pytest.mark.parametrize(
    "packages", [(*WITHOUT_DENOISING, *OLDEST), (f"{ROOT}[test]", "mitsuba==3.9.1")], ids=["3.9.0", "3.9.1"]
)
def test_quick_tests_pass(tmp_path, packages):
    """Takes some minutes each, most of them for the installation."""
    venv.create(tmp_path, with_pip=True)
    python = tmp_path / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
    alone = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}
    command = [python, "-m", "pytest", "-p", "no:cacheprovider"]
    done = subprocess.run(command, check=False, cwd=ROOT, env=alone, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-10000:]
