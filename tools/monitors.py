"""Write the table of monitors as a page: `python -m tools.monitors > docs/operate/monitors.md`. A test compares them."""

from __future__ import annotations

import math

from hal.safety.monitors import MONITORS, Monitor

HEAD = """# Monitors

The checks of inputs that stand in one table. This page is written by `python -m tools.monitors` from
[hal/safety/monitors.py](../../hal/safety/monitors.py). [safety.md](safety.md) tells the hazards, and the checks that are not in it. `python -m tools.bench faults --without MONITOR` shows what each one is good for.

Consequences, from the mildest on: *tell* (`status` says it), *degrade* (the input is not used), *hold* (zero velocity while it lasts),
*latch* (zero velocity until `resume`), *lost* (the pose is not known, the goal ends), *refuse* (the message, the file or the start).

| monitor | stream | allowed | beyond | judge | the operator reads | what to do | test |
|---|---|---|---|---|---|---|---|
"""


def allowed(row: Monitor) -> str:
    """Its limits in words."""
    unit = f" {row.unit}" if row.unit else ""
    if row.setting:
        limits = f"`{row.setting}`"
    elif math.isfinite(row.low) and math.isfinite(row.high):
        limits = f"{row.low:g} to {row.high:g}{unit}"
    elif math.isfinite(row.high):
        limits = f"<= {row.high:g}{unit}"
    elif math.isfinite(row.low):
        limits = f">= {row.low:g}{unit}"
    else:
        limits = row.check.value
    return f"{limits}, against {row.against}" if row.against else limits


def page() -> str:
    """The whole page."""
    rows = [
        f"| {r.name} | {r.stream} | {allowed(r)} | {r.consequence} | {r.judge} | {r.words.replace('|', '/')} | {r.remedy} | `{r.test}` |"
        for r in MONITORS
    ]
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(page(), end="")
