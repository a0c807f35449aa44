"""Files that are complete or not there, whatever the disk says; and nothing left behind."""

import os
import resource
import signal
import stat
import subprocess
import sys
import tempfile
from contextlib import contextmanager

import pytest
from mitsuba_prosim import atomic
from prosim_scene import PART


@contextmanager
def little_room(size):
    """No file of this process can be longer than ``size`` bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder for temporary files, a new one."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_all_or_nothing(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    with little_room(5), pytest.raises(OSError, match="File too large"):
        atomic.write({tmp_path / "a": b"new", tmp_path / "b": b"longer"})
    assert names(tmp_path) == ["a"] and (tmp_path / "a").read_bytes() == b"old"
    assert atomic.write({tmp_path / "a": b"new", tmp_path / "c" / "b": b"longer"}) == [
        tmp_path / "a",
        tmp_path / "c" / "b",
    ]
    assert names(tmp_path) == ["a", "c"] and names(tmp_path / "c") == ["b"]


def test_mode_and_link_stay(tmp_path):
    true, link = tmp_path / "true", tmp_path / "link"
    true.write_bytes(b"old")
    true.chmod(0o640)
    link.symlink_to(true)
    atomic.write({link: b"new"})
    assert link.is_symlink() and true.read_bytes() == b"new" and stat.S_IMODE(true.stat().st_mode) == 0o640
    (circle := tmp_path / "circle").symlink_to(circle)  # leads to nothing that could stay
    atomic.check([circle], 3)
    atomic.write({circle: b"new"})
    assert circle.read_bytes() == b"new"


def test_check_finds_what_writing_would(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    for path, says in [
        (tmp_path / "folder", "folder"),
        (tmp_path / "file" / "a", "no folder"),
        (tmp_path / "new" / ("é" * 200), "bytes"),
        (tmp_path / ("a" * (longest + 1)), f"at most {longest} bytes"),
    ]:
        with pytest.raises(OSError, match=says):
            atomic.check([path], 10)
    atomic.check([tmp_path / ("a" * longest), tmp_path / "new" / "deep" / "b"], 10)
    with little_room(1000):
        atomic.check([tmp_path / "a"], 1000)
        with pytest.raises(OSError, match="no file of 1001 bytes"):
            atomic.check([tmp_path / "a"], 1001)
    assert names(tmp_path) == ["file", "folder"]


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_check_finds_a_folder_that_is_read_only(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OSError, match="Permission denied"):
        atomic.check([tmp_path / "a"], 10)


def test_rescue_finds_another_place(tmp_path, temporary, monkeypatch):
    """The first that has room."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    contents = {tmp_path / "nowhere" / "a.exr": b"image", tmp_path / "nowhere" / "a.png": b"shown"}
    exr, png = atomic.rescue(contents)
    assert exr.parent.parent == temporary and exr.read_bytes() == b"image" and png.read_bytes() == b"shown"
    monkeypatch.setattr(tempfile, "tempdir", "/proc")
    assert atomic.rescue(contents)[0].parent.parent == home


def test_leftovers_of_killed_runs_are_removed(tmp_path, temporary):
    """Those of a run that goes on are not, nor is what is only called alike and new."""
    code = """if True:
        import os, signal, sys, tempfile
        from pathlib import Path
        from mitsuba_prosim import atomic
        with atomic.scratch() as folder:
            (folder / "mesh.ply").touch()
            def stop(*_):
                os.kill(os.getpid(), signal.SIGKILL)
            os.replace = stop
            print(folder, flush=True)
            sys.stdin.readline()
            atomic.write({Path(sys.argv[1], "image"): b"content"})
        """
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(temporary)},
    ) as process:
        folder = process.stdout.readline().decode().strip()
        os.utime(folder, (0, 0))
        with atomic.scratch():
            assert len(names(temporary)) == 2
        process.stdin.write(b"\n")
        process.stdin.flush()
        assert process.wait() == -signal.SIGKILL
    parts = [name for name in names(tmp_path) if name.startswith(PART)]
    assert len(parts) == 1
    with atomic.scratch():
        atomic.check([tmp_path / "image"], 10)
    assert names(tmp_path) == [*parts, "temporary"]  # it is new
    os.utime(tmp_path / parts[0], (0, 0))
    with atomic.scratch() as own:
        atomic.check([tmp_path / "image"], 10)
        assert names(temporary) == [own.name]
    assert names(tmp_path) == ["temporary"] and names(temporary) == []
