#!/usr/bin/env bash
# Sets up, fits the artist's material to the embedded sample on the relief that it recovers, and shows its maps, and an
# object beside the measured images (in a folder beside it, named -measured). Output: out/demo, or the first argument.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
out=${1:-"$root/out/demo"}
bash "$root/scripts/setup.sh"
"$root/.venv/bin/torchmat" fit "$root/configs/distribution.toml" --data sample --out "$out"
"$root/.venv/bin/torchmat" render "$out" --mesh patch teapot
"$root/.venv/bin/torchmat" render sample --mesh teapot --out "$out-measured"
