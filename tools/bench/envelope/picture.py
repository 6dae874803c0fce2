"""The picture of an envelope: measured cells against the fit, and where its bound forbids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from hal.envelope import MAX_RISK, Envelope

FACES = ("up", "down", "back_up", "back_down")


def draw(envelope: Envelope, path: Path) -> None:
    """Faces by height and angle on level ground: the fit's probability, the limit of its bound, trials with the share
    that failed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, plots = plt.subplots(1, len(FACES), figsize=(12.0, 3.2), sharey=True, layout="constrained")
    for plot, name in zip(plots, FACES, strict=True):
        table = envelope.manoeuvres[name]
        height, angle = table.axes[0].si, table.axes[1].values
        h, a = np.meshgrid(np.linspace(0.0, height[-1], 60), np.linspace(0.0, angle[-1], 60))
        p = envelope.mean(name, h, np.radians(a), 0.0)
        bound = envelope.bound(name, h, np.radians(a), 0.0)
        shade = plot.pcolormesh(100.0 * h, a, p, vmin=0.0, vmax=1.0, cmap="RdYlGn_r", shading="gouraud")
        plot.contour(100.0 * h, a, bound, levels=[MAX_RISK], colors="black", linewidths=1.2)
        trials, failures = table.trials[:, :, 0], table.failures[:, :, 0]
        for i, j in np.argwhere(trials > 0):
            share = failures[i, j] / trials[i, j]
            at = 100.0 * height[i], angle[j]
            plot.scatter(
                *at, s=14.0 * trials[i, j], c=[share], vmin=0, vmax=1, cmap="RdYlGn_r", edgecolors="k", lw=0.5
            )
        plot.set(title=f"{name} ({table.drives} drives)", xlabel="height of the face [cm]")
    plots[0].set_ylabel("angle to its normal [deg]")
    figure.colorbar(shade, ax=plots, label="probability of failure")
    figure.suptitle(
        f"{envelope.controller}: discs are trials (share that failed), the line is where no way begins"
    )
    figure.savefig(path, dpi=80)
    plt.close(figure)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(64).save(path, optimize=True)  # a quarter of the bytes
