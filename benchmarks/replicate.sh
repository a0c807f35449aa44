#!/usr/bin/env bash
# Measures six rows of a table of docs/benchmarks.md, draws a figure, and checks the numbers. This takes about ten minutes
# on two cores.
#
#     benchmarks/replicate.sh
#
# The script installs the package into .venv if this folder is missing. The results are in benchmarks/results:
# policies.md (gains of adaptive sampling at equal time) and penumbra.png (error against time, with crops).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
if [ ! -x .venv/bin/python ]; then
    python3 -m venv .venv
    .venv/bin/pip install -q -e '.[compare]' scipy psutil
fi
mkdir -p benchmarks/results
.venv/bin/python benchmarks/gains.py policies --scene penumbra aranha palito --rounds 10 --reference-seconds 40 |
    tee benchmarks/results/policies.md
.venv/bin/python benchmarks/convergence.py --scene penumbra --rounds 10 --reference-seconds 40 --output benchmarks/results |
    tee benchmarks/results/slopes.md
.venv/bin/python - <<'END'
import re
from pathlib import Path

#: Scene -> the smallest and the largest expected gain of `graded` over `none`, in samples, for the tone-mapped error.
#: This gain does not depend on the machine.
EXPECTED = {"penumbra": (3.5, 6.0), "aranha": (2.5, 4.5), "palito": (1.3, 2.0)}
rows = [re.split(r" *\| *", line.strip("| \n")) for line in Path("benchmarks/results/policies.md").open()]
found = {row[0]: float(row[4].split()[0]) for row in rows if row[1] == "graded"}
wrong = {name: found.get(name) for name, (low, high) in EXPECTED.items() if not low <= found.get(name, 0) <= high}
print("Gains of graded over none in samples:", found)
raise SystemExit(f"Outside of {EXPECTED}: {wrong}" if wrong else None)
END
