"""The benchmarks run: small images, few rounds. Their figures are not judged here."""

import importlib
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SMALL = ["--size", "24", "--rounds", "2", "--reference-seconds", "0"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "script, rows",
    [
        (["gains", "policies", "--scene", "penumbra", *SMALL], 2),
        (["gains", "denoised", "--scene", "Cornell box", *SMALL], 1),
        (["negative_results", "allocation", "frozen", "gradients", "--scene", "penumbra", *SMALL], 6),
        (["promises", "--scene", "penumbra", *SMALL], 4),
        (["materials", "--only", "phong", *SMALL], 1),
        (["convergence", "--scene", "24 lamps", *SMALL], 5),
        (["translator", "trees", "20", "--tree", "comb"], 1),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_a_table_is_printed(tmp_path, monkeypatch, capfd, script, rows):
    folder = ["--output", str(tmp_path)] if script[0] == "convergence" else []
    cache = ["--cache", str(tmp_path)] if "--reference-seconds" in script else []
    monkeypatch.syspath_prepend(BENCHMARKS)
    monkeypatch.setattr(sys, "argv", [*script, *cache, *folder])
    benchmark = importlib.import_module(script[0])
    monkeypatch.setattr(benchmark, "COUNTS", (2, 4), raising=False)
    benchmark.main()
    printed = capfd.readouterr().out
    assert len(printed.split("\n\n")[0].strip().splitlines()) == 2 + rows, printed
