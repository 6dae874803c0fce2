"""Packages that not every machine needs, and what to do where one is missing."""

from __future__ import annotations

from hal.errors import one_line

INSTALL_SIMULATOR = "uv sync, or pip install 'rbtrg-robot[sim]'"
INSTALL_DDS = "pip install 'rbtrg-robot[unitree]' (on aarch64 see docs/operate/deployment.md first)"


def open3d_hint(error: Exception) -> str:
    """Why open3d does not load, and what to install."""
    if isinstance(error, ModuleNotFoundError):
        return "open3d is not installed: pip install 'rbtrg-robot[mesh]' (glibc 2.35 or newer)"
    return (
        f"open3d does not load ({one_line(error)}). "
        "On Debian or Ubuntu: apt-get install libusb-1.0-0 libgl1 libx11-6 libgomp1"
    )
