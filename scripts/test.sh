#!/usr/bin/env bash
# Sets up and runs all tests; arguments go to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bash "$root/scripts/setup.sh" test
cd "$root"
exec "$root/.venv/bin/python" -m pytest "$@"
