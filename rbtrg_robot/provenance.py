"""What a log and a map came from: fingerprint of a file, versions, commit."""

from __future__ import annotations

import hashlib
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hal.regular import open_regular


def fingerprint(map_file: str) -> str:
    """Hash that names a prior map; empty where there is none. Raises OSError."""
    if not map_file:
        return ""
    with open_regular(map_file) as file:
        return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()[:16]}"


def package_version(package: str) -> str:
    """Of an installed package; the simulator and DDS are optional."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def commit() -> str:
    """Git commit of the source tree, or empty when installed from a wheel."""
    here = Path(__file__).resolve().parent
    found = subprocess.run(
        ["git", "-C", str(here), "rev-parse", "--short=12", "HEAD"],
        capture_output=True,
        text=True,
        check=False,
    )
    return found.stdout.strip() if found.returncode == 0 else ""
