"""The long form of the hard cases: ``python scripts/stress.py [part ...]``, all parts in under half an hour on two cores.

Each part that ends is written at once, so a run that is stopped goes on with the parts that are left: name them, or give
--resume. Exit code 1 when anything fails; what failed is named.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:1] = [str(ROOT), str(ROOT / "scripts" / "bench")]  # not this folder, whose fit.py is another fit

from tests.hard_cases import digests, stress_report  # noqa: E402
from tests.hard_cases.parts import PARTS, Settings, alone  # noqa: E402
from measure import RESULTS, machine  # noqa: E402

from torchmat.progress import progress  # noqa: E402


def parsed() -> argparse.Namespace:
    """Return the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="part", help=f"{', '.join(PARTS)} (default: all)")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results (default: scripts/bench/results)")
    parser.add_argument("--share", type=float, default=1.0, help="share of the inputs, to try it (default: 1)")
    parser.add_argument("--seed", type=int, default=1, help="seed of what is drawn at random (default: 1)")
    parser.add_argument("--jobs", type=int, default=2, help="parts at the same time, a process each (default: 2)")
    parser.add_argument("--resume", action="store_true", help="leave out parts that the folder has results of already")
    parser.add_argument("--store-digests", action="store_true", help="store the digests of small fits as what is right, and end")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def run_here(name: str, asked: argparse.Namespace) -> None:
    """Run one part in this process and write it by itself."""
    alone()
    start, settings = time.perf_counter(), Settings(asked.out, asked.share, asked.seed)
    rows = list(progress(PARTS[name](settings), name))
    part = {"seconds": round(time.perf_counter() - start, 1), "share": asked.share, "seed": asked.seed, "rows": rows}
    stress_report.write(asked.out, {name: part}, machine())


def run_apart(name: str, asked: argparse.Namespace) -> dict:
    """Run one part in a process of its own; return it. A part that breaks off is one failure."""
    start = time.perf_counter()
    print(f"{name}: started", flush=True)
    with tempfile.TemporaryDirectory(prefix="torchmat-stress-") as room:
        given = [name, "--alone", "--out", room, "--share", str(asked.share), "--seed", str(asked.seed)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        # Bars go to a terminal; in a pipe what libraries say of broken files is of use only when the part breaks off.
        heard = None if sys.stderr.isatty() else subprocess.PIPE
        done = subprocess.run([sys.executable, __file__, *given], stdout=subprocess.PIPE, stderr=heard, text=True, env=environment)
        found = stress_report.read(Path(room)).get(name)
        for picture in Path(room).glob("*.png"):
            (asked.out / picture.name).write_bytes(picture.read_bytes())
    seconds = time.perf_counter() - start
    if found is None:
        print((done.stderr or "")[-4000:], file=sys.stderr)
        note = f"the process ended with {done.returncode}; what it said stands above"
        row = {"case": name, "component": "the part itself", "count": 0, "passed": False, "figure": None, "note": note}
        found = {"seconds": round(seconds, 1), "share": asked.share, "seed": asked.seed, "rows": [row]}
    failed = sum(row["passed"] is False for row in found["rows"])
    print(f"{name}: {len(found['rows'])} rows, {failed} failed, {seconds:.0f} s", flush=True)
    return found


def main() -> int:
    """Run the parts that are asked for; return the exit code."""
    asked = parsed()
    if asked.store_digests:
        alone()
        digests.store(digests.results())
        print(f"stored for {digests.platform_key()}")
        return 0
    if asked.alone:
        run_here(asked.parts[0], asked)
        return 0
    asked.out.mkdir(parents=True, exist_ok=True)
    known = stress_report.read(asked.out)
    wanted = [name for name in asked.parts or PARTS if not (asked.resume and name in known)]
    with ThreadPoolExecutor(max(1, asked.jobs)) as pool:
        runs = {pool.submit(run_apart, name, asked): name for name in wanted}
        for run in as_completed(runs):
            known[runs[run]] = run.result()
            known = {name: known[name] for name in PARTS if name in known}
            stress_report.write(asked.out, known, machine())
    failed = stress_report.failures({name: known[name] for name in wanted})
    print("\n".join([*failed, f"{len(failed)} failures; results in {asked.out}"]))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
