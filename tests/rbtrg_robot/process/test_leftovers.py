"""Shared memory that killed processes leave: what nobody holds goes, what somebody holds stays."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

from rbtrg_robot.process.leftovers import SHARED_MEMORY, YOUNG, reap_segments

HOLDS = """
import sys, time, zenoh.shm
pool = zenoh.shm.ShmProvider.default_backend(65536)
print("up", flush=True)
time.sleep(60)
"""


def segment(folder: Path, name: str, age: float) -> Path:
    path = folder / name
    path.write_bytes(bytes(16))
    os.utime(path, (time.time() - age,) * 2)
    return path


def test_only_what_nobody_holds_and_is_not_being_made_goes(tmp_path: Path) -> None:
    dead = segment(tmp_path, "1.zenoh", 60.0)
    held, mapped = segment(tmp_path, "2.zenoh", 60.0), segment(tmp_path, "3.zenoh", 60.0)
    young = segment(tmp_path, "4.zenoh", 0.0)
    other = segment(tmp_path, "5.other", 60.0)
    (tmp_path / "6.zenoh").symlink_to(other)
    with held.open() as own, mapped.open() as shared:
        fcntl.flock(own, fcntl.LOCK_EX)
        fcntl.flock(shared, fcntl.LOCK_SH)
        assert reap_segments(tmp_path) == 1
        assert not dead.exists()
        assert held.exists()
        assert mapped.exists()
    assert young.exists()
    assert other.exists()
    assert reap_segments(tmp_path) == 2, "the lock goes with who held it"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["4.zenoh", "5.other", "6.zenoh"]
    assert reap_segments(tmp_path / "absent") == 0


def test_zenoh_holds_its_segments_while_it_lives_and_leaves_them_when_killed() -> None:
    """With the installed Zenoh: the rule above rests on its lock."""
    before = set(SHARED_MEMORY.glob("*.zenoh"))
    process = subprocess.Popen([sys.executable, "-c", HOLDS], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        mapped = {
            Path(line.split()[-1])
            for line in Path(f"/proc/{process.pid}/maps").read_text().splitlines()
            if line.endswith(".zenoh")
        }
        assert mapped
        assert not mapped & before
        for path in mapped:
            os.utime(path, (time.time() - 2 * YOUNG,) * 2)
        reap_segments()
        assert all(path.exists() for path in mapped), "a living process keeps its own"
    finally:
        process.kill()
        process.communicate()
    reap_segments()
    assert not any(path.exists() for path in mapped)
