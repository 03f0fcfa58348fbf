#!/usr/bin/env bash
# Sets up and runs all tests; arguments go to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bash "$root/scripts/setup.sh" test
cd "$root"
# Two processes of one thread each: on small tensors that is twice as fast as one process of two threads.
export OMP_NUM_THREADS=1
# Tests of two threads share the cores with the other process: threads that spin while they wait would take its time.
export GOMP_SPINCOUNT=1000
exec "$root/.venv/bin/python" -m pytest -n 2 "$@"
