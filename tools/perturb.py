"""Closed loops under other noise: what a test asserts of one drive must hold of its neighbours.

    python -m tools.perturb [--seeds 10] [--generic] [TEST ...]

Each round draws the noise of the simulated sensors anew and runs the tests; the table names those that failed, and in
how many rounds.
A drive is chaotic, so the last bits of another processor do what other noise does. `--generic` compiles the kernels for
the plainest x86-64
and uses another BLAS kernel besides.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parent.parent
GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "OPENBLAS_CORETYPE": "Nehalem"}


def closed_loops() -> list[str]:
    """Test files that drive the stack in lockstep."""
    return sorted(
        str(file.relative_to(ROOT))
        for file in (ROOT / "tests").rglob("test_*.py")
        if "Lockstep(" in file.read_text()
    )


def failed(tests: list[str], noise: int, generic: bool) -> dict[str, str]:
    """Message by name of the tests that fail with this noise."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "junit.xml"
        command = [
            sys.executable,
            "-m",
            "pytest",
            *tests,
            f"--noise={noise}",
            f"--junitxml={out}",
            "--timeout=900",
            "-q",
        ]
        subprocess.run(
            command,
            cwd=ROOT,
            env={**os.environ, **(GENERIC if generic else {})},
            stdout=subprocess.DEVNULL,
            check=False,
        )
        if not out.is_file():
            raise SystemExit(f"error: pytest ended before it ran a test; try: {' '.join(command)}")
        cases = list(ElementTree.parse(out).iter("testcase"))
    bad = {}
    for case in cases:
        for kind in ("failure", "error"):
            if (node := case.find(kind)) is not None:
                bad[f"{case.get('classname')}::{case.get('name')}"] = (
                    node.get("message") or kind
                ).splitlines()[0]
    return bad


def main() -> int:
    """Exit status 1 where a test failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.perturb", description=__doc__)
    parser.add_argument("tests", nargs="*", help="default: every file that drives in lockstep")
    parser.add_argument("--seeds", type=int, default=10, help="rounds of other noise")
    parser.add_argument("--generic", action="store_true", help="other machine code besides")
    options = parser.parse_args()
    found: dict[str, list[str]] = defaultdict(list)
    for noise in range(1, options.seeds + 1):
        for name, message in failed(options.tests or closed_loops(), noise, options.generic).items():
            found[name].append(f"{noise}: {message}")
    for name, messages in sorted(found.items()):
        print(f"{name}: failed in {len(messages)} of {options.seeds} rounds")
        for message in messages:
            print(f"  {message[:160]}")
    print(f"{len(found)} tests failed in some round of {options.seeds}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
