#!/usr/bin/env bash
# Sets up and runs all tests; arguments go to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bash "$root/scripts/setup.sh" test
# Tests of pages drive Chromium. Where it cannot be had they skip, and say so.
if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null && ! command -v chromium > /dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    { apt-get update && timeout 300 apt-get install --yes --no-install-recommends chromium; } > /dev/null 2>&1 ||
        echo "test: chromium could not be installed; tests of pages skip." >&2
fi
cd "$root"
# Two processes of one thread each: on small tensors that is twice as fast as one process of two threads.
export OMP_NUM_THREADS=1
# Tests of two threads share the cores with the other process: threads that spin while they wait would take its time.
export GOMP_SPINCOUNT=1000
# Both processes, and the children that tests start, share what was compiled once.
unset PYTHONDONTWRITEBYTECODE
"$root/.venv/bin/python" -m compileall -q torchmat
# Each process keeps to a stretch of its own, so that what the tests of a file share is made by one of them, until one has none left.
exec "$root/.venv/bin/python" -m pytest -n 2 --dist worksteal "$@"
