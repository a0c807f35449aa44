#!/usr/bin/env bash
# Tries each command of an installed wheel on small scenes: tests/try_wheel.sh, with the command prosim on the PATH.
set -euxo pipefail
examples=$(cd "$(dirname "${BASH_SOURCE[0]}")/../examples" && pwd)
cd "$(mktemp -d)"
cp "$examples"/{palito,fontes,caustica}.scn .
prosim doctor
prosim render palito.scn --resolution 64x64 --noise 0.05 --checkpoint
prosim resume palito.state.npz --noise 0.04
prosim render palito.scn --resolution 64x64 -o parts --part 1/2
prosim render palito.scn --resolution 64x64 -o parts --part 2/2
prosim merge parts.*-of-2.npz -o parts
prosim render fontes.scn --resolution 64x48 --layers lights
prosim mix fontes.exr light_0=0.5 -o evening
prosim render caustica.scn --resolution 64x48 --caustics --denoise
prosim explain palito.scn --pixel 250,250
prosim translate palito.scn -o translated
prosim format palito.scn
prosim check prosim_lambertian
prosim compare palito.scn --resolution 32x32 --rounds 1 --reference-seconds 1
prosim language-server </dev/null
timeout 20 prosim watch palito.scn --no-browser || [ $? = 124 ]
ls palito.png parts.exr evening.png caustica.exr palito-compare.html translated* >/dev/null
