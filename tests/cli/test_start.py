"""How the ``prosim`` command starts and ends, as a process."""

import os
import signal
import subprocess
import sys

import pytest

START = [sys.executable, "-m", "prosim_start"]


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from prosim_start.group import prosim; prosim(['-h'], standalone_mode=False); "
        "print({'mitsuba', 'drjit', 'numpy', 'prosim_scene'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "compare" in done.stdout and done.stdout.endswith("set()\n")


def test_ctrl_c_at_the_start_ends_the_process(tmp_path):
    """While modules are imported, here one that takes a minute, in Python or beyond it."""
    slow = tmp_path / "mitsuba_prosim"
    slow.mkdir()
    env = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    for waiting in "time.sleep(60)", "ctypes.CDLL(None).sleep(60)":
        (slow / "__init__.py").write_text(f"import ctypes, time; print('importing', flush=True); {waiting}")
        with subprocess.Popen([*START, "doctor"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env) as process:
            assert process.stdout.readline() == b"importing\n"
            process.send_signal(signal.SIGINT)
            said = process.stderr.read()
        assert process.returncode == -signal.SIGINT and said == b""  # 130 in a shell


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_standard_output_that_is_full():
    with open("/dev/full", "w") as full:
        done = subprocess.run([*START, "-h"], check=False, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr and "Traceback" not in done.stderr and done.stderr.count("\n") == 1


def test_standard_output_that_is_closed():
    """The next file that is opened must not take its place."""
    code = """if True:
        import os, sys
        os.close(1)
        sys.stdout = None
        from prosim_start import open_if_closed
        open_if_closed(1, "stdout")
        print("nowhere", flush=True)
        sys.exit(os.open(os.devnull, os.O_RDONLY))"""
    assert subprocess.run([sys.executable, "-c", code], check=False, stdout=subprocess.PIPE).returncode > 2
