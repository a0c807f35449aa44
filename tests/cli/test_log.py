"""Mitsuba's log, and the progress of a command."""

import re
import subprocess
import sys

import mitsuba as mi
import pytest
from mitsuba_prosim.cli.log import log
from mitsuba_prosim.cli.progress import Progress
from tqdm import tqdm

#: A thread makes a scene of a dozen native plugins, each of which is logged under Mitsuba's locks. After the first the
#: main thread keeps the interpreter to itself for a second; prints how many lines were logged until its end.
HOLD_THE_INTERPRETER = """
import ctypes, os, threading
import mitsuba as mi
import mitsuba_prosim
from mitsuba_prosim.cli.log import log

mi.set_variant("llvm_ad_rgb")
names = "diffuse conductor dielectric plastic roughplastic roughconductor roughdielectric principled null".split()
shapes = "".join(f'<shape type="sphere"><bsdf type="{name}"/></shape>' for name in names)
config = mi.parser.ParserConfig(mi.variant())
state = mi.parser.parse_string(config, f'<scene version="3.0.0">{shapes}</scene>')
libc = ctypes.PyDLL(None)  # calls of it do not release the interpreter
with log(2):
    thread = threading.Thread(target=mi.parser.instantiate, args=(config, state))
    thread.start()
    while os.fstat(1).st_size == 0:
        pass
    libc.usleep(1_000_000)
    size = libc.lseek(1, 0, os.SEEK_END)
    lines = os.pread(1, size, 0).count(b"\\n")
    thread.join()
print(lines)
"""


@pytest.mark.slow
def test_logging_needs_no_interpreter():
    """Else a thread that logs and one that makes a plugin in Python can wait for each other for ever."""
    command = [sys.executable, "-c", HOLD_THE_INTERPRETER]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    assert int(done.stdout) >= 9
    assert 'Loading plugin "plugins/principled' in done.stderr


@pytest.mark.parametrize("verbose, expected", [(0, ["warning", "lines"]), (1, ["information", "warning", "lines"])])
def test_log_goes_to_standard_error(variant_rgb, capfd, verbose, expected):
    with log(verbose):
        mi.Log(mi.LogLevel.Debug, "debugging")
        mi.Log(mi.LogLevel.Info, "information")
        for _ in range(2):
            mi.Log(mi.LogLevel.Warn, "warning\nof two lines")
    print("afterwards")
    printed = capfd.readouterr()
    assert [line.split()[-1] for line in printed.err.splitlines()] == expected
    assert printed.out == "afterwards\n" and "\x1b" not in printed.err


def test_a_log_has_few_lines(capsys, monkeypatch):
    """An hour is some forty lines; the part that is done never becomes less."""
    now = 0.0
    monkeypatch.setattr("tqdm.std.time", lambda: 1000 + now)
    with Progress("comparing") as steps:
        for second in range(3601):
            now = second
            steps.show(second % 1800 / 1800, "reference" if second < 1800 else "rounds")
        said = capsys.readouterr().err.splitlines()
        assert said[:2] == ["reference: 1 %, 00:10 passed, 29:50 left", "reference: 1 %, 00:20 passed, 29:40 left"]
        assert 30 < len(said) < 45 and re.fullmatch(r"rounds: \d\d %, 2\d:\d\d passed, 0\d:\d\d left", said[-1])
        tqdm.write("warning: between", file=sys.stderr)
        assert capsys.readouterr().err == "warning: between\n"
    assert capsys.readouterr().err == ""
