"""A policy of ours: one npz file with a JSON header (`PolicyParams`, how it was trained, what it can do) and its
layers.

The numbers are float16: 100,000 of them take 200 kB."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from hal.npzfile import read_npz
from hal.robots.go2w.locomotion.rlsar import FRAME_LENGTH, PolicyParams
from hal.robots.go2w.locomotion.torchfile import ACTIVATIONS, Layer, PolicyError

FORMAT = "rbtrg-policy-1"
MAX_BYTES = 64e6
"""Of all layers: ours take 0.4 MB."""


def save_weights(path: Path, params: PolicyParams, layers: Sequence[Layer], facts: Mapping[str, Any]) -> None:
    """Write a policy; `facts` is what a reader should know of it and must be JSON."""
    header = {
        "format": FORMAT,
        "params": params.model_dump(mode="json"),
        "activations": [layer.activation for layer in layers],
        "facts": dict(facts),
    }
    arrays = {f"weight{k}": np.asarray(layer.weight, np.float16) for k, layer in enumerate(layers)}
    arrays |= {f"bias{k}": np.asarray(layer.bias, np.float16) for k, layer in enumerate(layers)}
    np.savez_compressed(path, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]


def load_weights(path: Path) -> tuple[PolicyParams, list[Layer], dict[str, Any]]:
    """What `save_weights` wrote. Raises PolicyError."""
    try:
        file = read_npz(path, MAX_BYTES)
        header = json.loads(str(file["header"]))
        if header["format"] != FORMAT:
            raise PolicyError(f"{path} is of format {header['format']}: this version reads {FORMAT}")
        params = PolicyParams.model_validate(header["params"])
        layers = [
            Layer(file[f"weight{k}"].astype(np.float32), file[f"bias{k}"].astype(np.float32), str(kind))
            for k, kind in enumerate(header["activations"])
        ]
        facts = dict(header["facts"])
    except FileNotFoundError as error:
        raise PolicyError(f"{path} does not exist: give the file of a policy with --policy FILE") from error
    except ValidationError as error:
        raise PolicyError(f"{path}: {error.errors()[0]['msg']}") from error
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror or error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise PolicyError(f"{path} is not a policy file ({error}): export it again") from error
    if not layers or any(layer.activation not in ACTIVATIONS for layer in layers):
        raise PolicyError(f"{path} holds no layers, or activations other than {', '.join(ACTIVATIONS)}")
    sizes = [FRAME_LENGTH * len(params.ages), *(layer.weight.shape[0] for layer in layers)]
    fit = all(
        layer.weight.ndim == 2 and layer.weight.shape[1] == before and layer.bias.shape == (after,)
        for layer, (before, after) in zip(layers, itertools.pairwise(sizes), strict=True)
    )
    if not fit or sizes[-1] != 16:
        raise PolicyError(f"{path}: its layers do not map {sizes[0]} numbers to 16")
    if not all(np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all() for layer in layers):
        raise PolicyError(f"{path} holds numbers that are not finite: export it again")
    return params, layers, facts
