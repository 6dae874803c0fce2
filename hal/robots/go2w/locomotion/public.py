"""Published learnt policies: fetched once from their repository at a fixed commit, checked, kept in the user's data
folder."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path

from hal.robots.go2w.locomotion.torchfile import PolicyError

SERVER_TIMEOUT = 30.0
"""Longest silence of the server [s]."""
LARGEST_FILE = 8_000_000
"""No file of a policy has more bytes."""


@dataclass(frozen=True, slots=True)
class Published:
    """A policy in somebody's repository."""

    name: str
    source: str
    """URL below which the files lie; names repository and commit."""
    licence: str
    files: tuple[tuple[str, str, str], ...]
    """Path in the repository, name here, SHA-256."""


POLICIES = {
    "go2w_rl_sar": Published(
        "go2w_rl_sar",
        "https://raw.githubusercontent.com/fan-ziqi/rl_sar/e384912",
        "Apache-2.0, Copyright (c) 2024-2025 Ziqi Fan",
        (
            ("LICENSE", "LICENSE", "6c18491053290fe1bada9775674b2b14493c4f0fdeab41e013dd5d4c82461d57"),
            (
                "policy/go2w/base.yaml",
                "base.yaml",
                "b7ab3eef1c05b19af84121c96a54e11511a7594411a287db9ee9bb1004d82776",
            ),
            (
                "policy/go2w/robot_lab/config.yaml",
                "config.yaml",
                "cb4c80a3f3ee1a37b7fa099e6c2581c91fafe00df7ce1ed5885ec16196f3d700",
            ),
            (
                "policy/go2w/robot_lab/policy.pt",
                "policy.pt",
                "eda0c490dfc75428fb6706d50924ebe2a91fca40ef21fae8747565699c81a2ac",
            ),
        ),
    ),
}
DEFAULT = "go2w_rl_sar"
"""The one that RB-TRG's paper used."""


def data_folder() -> Path:
    """Where fetched policies lie: rbtrg/policies in XDG_DATA_HOME, else in ~/.local/share."""
    base = os.environ.get("XDG_DATA_HOME")
    return (Path(base) if base else Path.home() / ".local" / "share") / "rbtrg" / "policies"


def published(name: str) -> Published:
    """The policy of that name. Raises PolicyError."""
    if name not in POLICIES:
        raise PolicyError(f"there is no public policy {name!r}: there is {', '.join(POLICIES)}")
    return POLICIES[name]


def stored(name: str) -> Path:
    """Folder of a fetched policy. Raises PolicyError where there is none."""
    folder = data_folder() / published(name).name
    if not folder.is_dir():
        raise PolicyError(
            f"the policy {name} is not on this computer: fetch it with `rbtrg-robot policy get {name}`, or "
            "name a folder with --policy DIR"
        )
    return folder


def get(name: str, source: str = "") -> tuple[Path, bool]:
    """Fetch a policy. -> its folder, and whether it had to be fetched.

    `source`: another URL that holds the repository's files. The folder appears whole or not at all. Raises PolicyError.
    """
    policy = published(name)
    folder = data_folder() / name
    if folder.is_dir() and all(_sum(folder / local) == wanted for _, local, wanted in policy.files):
        return folder, False
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{name}.", dir=folder.parent))
    except OSError as error:
        raise PolicyError(f"{folder.parent} cannot be written: {error.strerror or error}") from error
    try:
        for path, local, wanted in policy.files:
            url = f"{(source or policy.source).rstrip('/')}/{path}"
            data = _fetch(url)
            found = hashlib.sha256(data).hexdigest()
            if found != wanted:
                raise PolicyError(
                    f"{url} is not the file that was published: SHA-256 {found[:12]}..., not "
                    f"{wanted[:12]}...; nothing was kept"
                )
            (part / local).write_bytes(data)
        shutil.rmtree(folder, ignore_errors=True)
        part.rename(folder)
    except OSError as error:
        raise PolicyError(f"{folder} cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder, True


def _fetch(url: str) -> bytes:
    """The bytes at a URL. Raises PolicyError."""
    again = "check the network and run the command again; nothing was kept"
    try:
        with urllib.request.urlopen(url, timeout=SERVER_TIMEOUT) as response:
            data: bytes = response.read(LARGEST_FILE + 1)
            length = response.headers.get("Content-Length")
    except urllib.error.HTTPError as error:
        raise PolicyError(
            f"{url}: the server answers {error.code} {error.reason}; nothing was kept"
        ) from error
    except (OSError, HTTPException, ValueError) as error:
        reason = getattr(error, "reason", error)
        raise PolicyError(f"{url} cannot be fetched ({reason}): {again}") from error
    if len(data) > LARGEST_FILE:
        raise PolicyError(f"{url} is larger than {LARGEST_FILE // 1_000_000} MB; nothing was kept")
    if length is not None and len(data) < int(length):
        raise PolicyError(f"{url} was cut off after {len(data)} of {length} bytes: {again}")
    return data


def _sum(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def fetch(name: str, source: str = "") -> Iterator[str]:
    """`get`, told line by line. Raises PolicyError."""
    policy = published(name)
    yield f"{name} from {source or policy.source}"
    yield f"licence: {policy.licence}"
    folder, fetched = get(name, source)
    yield f"{folder}: {'fetched and checked' if fetched else 'already there, checked'}; the licence is in LICENSE"
