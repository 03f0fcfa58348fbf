"""Run the benchmarks and write their results beside this file: ``python scripts/bench/run.py [suite ...]``.

Two benchmarks at once would measure each other: run nothing else meanwhile.
"""

from __future__ import annotations

import argparse

from measure import save
from suites import SUITES


def main() -> None:
    """Run the named suites, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suites", nargs="*", choices=[*SUITES, []], help="which suites (default: all)")
    for name in parser.parse_args().suites or SUITES:
        print(f"== {name}")
        save(name, SUITES[name]())


if __name__ == "__main__":
    main()
