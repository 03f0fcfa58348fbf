#!/usr/bin/env bash
# Sets up, fits the embedded sample, prints a table and names the pictures. Output: out/demo, or the first argument.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
out=${1:-"$root/out/demo"}
bash "$root/scripts/setup.sh"
"$root/.venv/bin/torchmat" fit "$root/configs/phong_srf_half_light.toml" --data sample --out "$out"
"$root/.venv/bin/torchmat" render "$out"
