#!/usr/bin/env bash
# Sets up and runs all tests; arguments go to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bash "$root/scripts/setup.sh" test
cd "$root"
# Two processes of one thread each: on small tensors that is twice as fast as one process of two threads.
export OMP_NUM_THREADS=1
exec "$root/.venv/bin/python" -m pytest -n 2 "$@"
