"""The quick tests pass with the oldest packages that pyproject.toml admits, and with each Mitsuba, each for itself."""

import os
import re
import subprocess
import venv
from collections.abc import Iterator
from pathlib import Path

import pytest

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10, where pytest brings its ancestor
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OLDEST = ("mitsuba==3.9.0", 'numpy==1.26.*; python_version < "3.13"', "lark==1.2.*")

#: It is built for Dr.Jit 1.5, which is that of Mitsuba 3.9.1.
NOT_WITH_THE_OLDEST = "mitsuba-oidn"


def needed(extra: str, but: str) -> Iterator[str]:
    """The packages of an extra, those of others that it names included, but for one."""
    for requirement in EXTRAS[extra]:
        if found := re.fullmatch(r"mitsuba-prosim\[(.*)\]", requirement):
            for other in found[1].split(","):
                yield from needed(other, but)
        elif not requirement.startswith(but):
            yield requirement


@pytest.mark.versions
@pytest.mark.parametrize(
    "packages",
    [(str(ROOT), *needed("test", NOT_WITH_THE_OLDEST), *OLDEST), (f"{ROOT}[test]", "mitsuba==3.9.1")],
    ids=["3.9.0", "3.9.1"],
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
