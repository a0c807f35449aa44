"""Files are complete or absent, whatever the disk does, and nothing is left behind."""

import os
import resource
import signal
import stat
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from mitsuba_prosim import atomic


@contextmanager
def little_room(size):
    """No file of this process can be longer than ``size`` bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_is_complete_or_as_before(tmp_path):
    a, b, c = tmp_path / "a", tmp_path / "b", tmp_path / "c" / "b"
    a.write_bytes(b"old")
    with little_room(5), pytest.raises(OSError, match="File too large"):
        atomic.write({b: b"new", a: b"longer"})
    with little_room(5), pytest.raises(OSError, match="File too large"):
        atomic.write({c.parent / "new" / "deep": b"longer"})
    assert sorted(os.listdir(tmp_path)) == ["a", "b"] and a.read_bytes() == b"old"
    assert atomic.write({a: b"new", c: lambda path: path.write_bytes(b"longer")}) == [a, c]
    assert sorted(os.listdir(tmp_path)) == ["a", "b", "c"] and c.read_bytes() == b"longer"


def test_mode_stays_and_link_is_replaced(tmp_path):
    true, link = tmp_path / "true", tmp_path / "link"
    true.write_bytes(b"old")
    true.chmod(0o640)
    atomic.write({true: b"new"})
    assert true.read_bytes() == b"new" and stat.S_IMODE(true.stat().st_mode) == 0o640
    link.symlink_to(true)
    (circle := tmp_path / "circle").symlink_to(circle)
    for path in link, circle:
        atomic.check([path], 3)
        atomic.write({path: b"newer"})
        assert not path.is_symlink() and path.read_bytes() == b"newer"
        assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask()
    assert true.read_bytes() == b"new"


def umask():
    os.umask(mask := os.umask(0))
    return mask


def test_writability_check_finds_the_errors_of_writing(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    for path, says in [
        (tmp_path / "folder", "this is a folder"),
        (tmp_path / "file" / "a", "Not a directory"),
        (tmp_path / ("é" * 200), "too long"),
        (tmp_path / ("a" * (longest + 1)), "too long"),
    ]:
        with pytest.raises(OSError, match=says):
            atomic.check([path], 10)
    atomic.check([tmp_path / ("a" * longest), tmp_path / "new" / "deep" / "b"], 10)
    with pytest.raises(OSError, match=f"no file of {1 << 60} bytes can be written there: No space"):
        atomic.check([tmp_path / "a"], 1 << 60)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_check_finds_a_folder_that_is_read_only(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OSError, match="Permission denied"):
        atomic.check([tmp_path / "a"], 10)


def test_rescue_finds_the_first_place_with_room(tmp_path, monkeypatch):
    for name in "TMPDIR", "HOME":
        (tmp_path / name).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "HOME"))
    contents = {tmp_path / "nowhere" / "a.exr": b"image", tmp_path / "nowhere" / "a.png": b"shown"}
    for place in "TMPDIR", "HOME":
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "TMPDIR") if place == "TMPDIR" else "/proc")
        exr, png = atomic.rescue(contents)
        assert exr.parent.parent == tmp_path / place and exr.read_bytes() == b"image" and png.read_bytes() == b"shown"


EXAMPLE = Path(__file__).parents[2] / "examples" / "penumbra.scn"
SCRATCH = "with atomic.scratch() as folder: wait(folder / 'a')"
WRITE = "atomic.write({Path(os.environ['TMPDIR'], 'a'): wait})"
LOAD = "scene = prosim_scene.load(EXAMPLE); wait(Path(scene['surface_0']['filename']))"


@pytest.mark.slow
@pytest.mark.parametrize(
    "work, number", [(SCRATCH, signal.SIGKILL), (WRITE, signal.SIGTERM), (WRITE, None), (LOAD, signal.SIGTERM)]
)
def test_temporary_folder_is_deleted_when_the_process_ends(tmp_path, work, number):
    code = f"""if True:
        import os, sys
        from pathlib import Path
        import prosim_scene
        from mitsuba_prosim import atomic

        EXAMPLE = {str(EXAMPLE)!r}

        def wait(path):
            path.write_bytes(b"content")
            print(path, flush=True)
            sys.stdin.read()

        {work}
    """
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command, env = [sys.executable, "-c", code], os.environ | {"TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, env=env, start_new_session=True, **pipes) as process:
        file = Path(process.stdout.readline().strip())
        assert file.parent.parent == tmp_path and stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        if number:
            os.killpg(process.pid, number)
        process.communicate()
    end = time.monotonic() + 20
    while file.parent.exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert process.returncode == -(number or 0)
    assert os.listdir(tmp_path) == (["a"] if work == WRITE and not number else [])
