"""The quick tests pass with the oldest packages that pyproject.toml admits, and with each Mitsuba, each for itself."""

import os
import subprocess
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OLDEST = ("mitsuba==3.9.0", 'numpy==1.26.*; python_version < "3.13"', "lark==1.2.*")


@pytest.mark.versions
@pytest.mark.parametrize("packages", [OLDEST, ("mitsuba==3.9.1",)], ids=lambda packages: packages[0])
def test_quick_tests_pass(tmp_path, packages):
    """Takes some minutes each, most of them for the installation."""
    venv.create(tmp_path, with_pip=True)
    python = tmp_path / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", f"{ROOT}[test]", *packages], check=True)
    alone = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}
    done = subprocess.run(
        [python, "-m", "pytest", "-p", "no:cacheprovider"],
        check=False,
        cwd=ROOT,
        env=alone,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-10000:]
