"""Where the checkout is, and reference data that may lie beside it."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
GOLDEN = SHARED / "golden"
TERRAIN = SHARED / "data" / "terrain"
POLICY = SHARED / "data" / "policies" / "go2w_rl_sar"

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="reference data do not lie beside the checkout")
"""Only the absence of the whole folder skips: a file that is missing in it fails."""


def extension(name: str, page: str = "extend.md") -> str:
    """The code of `name`.py on a page of the docs."""
    lead = f'"""{name}.py'
    return lead + (ROOT / "docs" / page).read_text().split(f"```python\n{lead}")[1].split("```")[0]


def cases(count: int, usual: int) -> list[Any]:
    """For `parametrize`: numbers from 0 on, of which those after the `usual` ones are further cases of the same."""
    return [*range(usual), *(pytest.param(k, marks=pytest.mark.campaign) for k in range(usual, count))]


@cache
def no_opengl() -> str:
    """Why nothing can be drawn on this machine; empty where pictures can."""
    from hal.mujoco.view.render import RenderError, gl_context

    try:
        gl_context(16, 16).free()
    except RenderError as error:
        return str(error)
    return ""


def needs_gl() -> None:
    """Skip where the machine has no OpenGL."""
    if no_opengl():
        pytest.skip(no_opengl())


def needs_open3d() -> None:
    """Skip where open3d does not load; on CI's machine, which installs its system libraries, fail."""
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        if os.environ.get("CI") and platform.machine() == "x86_64":
            pytest.fail(f"open3d must load on CI: {error}")
        pytest.skip(f"open3d does not load: {error}")
