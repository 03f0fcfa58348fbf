#!/usr/bin/env bash
# Makes .venv beside the project's pyproject.toml and installs torchmat into it with the extras named as arguments.
# Quick when nothing changed: a stamp remembers what was installed. PYTHON chooses the interpreter.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
extras=${1:-}
venv="$root/.venv"
python=${PYTHON:-python3}

"$python" - <<'PY' || { echo "setup: Python 3.11 or newer is needed; set PYTHON to one." >&2; exit 1; }
import sys
sys.exit(sys.version_info < (3, 11))
PY

[ -x "$venv/bin/python" ] || { rm -rf "$venv"; "$python" -m venv "$venv"; }
wanted="$(cksum < "$root/pyproject.toml") [$extras]"
stamp="$venv/.torchmat-installed"
if ! grep -qxF "$wanted" "$stamp" 2>/dev/null; then
    echo "setup: installing torchmat${extras:+[$extras]} into $venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e "$root${extras:+[$extras]}"
    echo "$wanted" >> "$stamp"
fi
