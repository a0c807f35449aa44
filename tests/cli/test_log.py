"""Mitsuba's log, and the progress of a command; how it starts and ends, as a process."""

import io
import os
import signal
import subprocess
import sys

import mitsuba as mi
import pytest
from mitsuba_prosim.cli.terminal import Progress, log
from running import PIPES
from waiting import PATIENCE, started


@pytest.mark.parametrize("verbose, expected", [(0, ["warning", "lines"]), (1, ["information", "warning", "lines"])])
def test_log_goes_to_standard_error(variant_rgb, capfd, tmp_path, verbose, expected):
    """Without an appender in Python: a thread that logs through one, and one that makes a plugin in Python, can wait
    for each other for ever.
    """
    appenders = mi.logger().appender_count()
    with log(verbose, tmp_path):
        assert mi.logger().appender_count() == appenders
        mi.Log(mi.LogLevel.Debug, "debugging")
        mi.Log(mi.LogLevel.Info, "information")
        for _ in range(2):
            mi.Log(mi.LogLevel.Warn, "warning\nof two lines")
    print("afterwards")
    printed = capfd.readouterr()
    assert [line.split()[-1] for line in printed.err.splitlines()] == expected
    assert printed.out == "afterwards\n" and "\x1b" not in printed.err


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_bar_is_drawn_on_a_terminal_alone(capsys, monkeypatch):
    """It knows no remaining time at the beginning, and moves back if the render expects more work."""
    with Progress("rendering") as steps:
        steps.show(0.5)
    assert capsys.readouterr().err == ""
    now = 0.0
    monkeypatch.setattr("tqdm.std.time", lambda: 1000 + now)
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with Progress("comparing") as steps:
        for second in range(3600):
            now = second
            steps.show(second % 1800 / 1800, "reference" if second < 1800 else "rounds")
            assert ("? left" in str(steps)) == (second % 1800 < 9)
        steps.show(0.25, "rounds")
        assert steps.n == 0.25 and "rounds:  25%" in str(steps)
    said = terminal.getvalue()
    assert "\rcomparing:   0%" in said and "\rreference:  50%" in said and said.endswith("\r")


# ---- As a process


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
        with started([*START, "doctor"], **PIPES, env=env) as process:
            assert process.stdout.readline() == b"importing\n"
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=PATIENCE)
        assert process.returncode == -signal.SIGINT and said == b""  # 130 in a shell


def test_deleted_current_folder_is_named(tmp_path):
    code = "import os, prosim_start; os.rmdir(os.getcwd()); prosim_start.main()"
    (gone := tmp_path / "gone").mkdir()
    done = subprocess.run([sys.executable, "-c", code, "doctor"], check=False, capture_output=True, text=True, cwd=gone)
    assert done.returncode == 2 and done.stderr == "Error: the current folder was deleted; change to another folder.\n"


@pytest.mark.slow
def test_names_of_files_are_utf_8_in_any_locale(write_scene):
    """Also where Python would read them as ASCII."""
    scene = write_scene("LIGHTS POINT position 0 9 9 CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END", "maçã.scn")
    env = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0"}
    done = subprocess.run([*START, "translate", scene], check=False, capture_output=True, env=env)
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode() == f"{scene.with_suffix('.xml')}\n" and scene.with_suffix(".xml").exists()
    ascii_only = [sys.executable, "-X", "utf8=0", *START[1:], "translate", scene]
    done = subprocess.run(ascii_only, check=False, capture_output=True, env=env, timeout=PATIENCE)
    assert done.returncode == 2 and b"in UTF-8" in done.stderr
    env["PYTHONIOENCODING"] = "latin-1"
    named = [*START, "translate", scene, "-o", scene.with_name("π")]
    done = subprocess.run(named, check=False, capture_output=True, env=env, timeout=PATIENCE)
    assert done.returncode == 0 and rb"\u03c0" in done.stdout, done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_full_standard_output_is_one_message():
    with open("/dev/full", "w") as full:
        done = subprocess.run([*START, "-h"], check=False, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr and "Traceback" not in done.stderr and done.stderr.count("\n") == 1


def test_closed_standard_output_is_one_message():
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
