"""Read the layers of a TorchScript multi-layer perceptron without torch.

A .pt file is a zip archive: `data.pkl` pickles the module tree, `data/N` holds the raw numbers of storage N. The
unpickler below knows the few names such a tree needs and refuses every other one, so a file cannot run code."""

from __future__ import annotations

import itertools
import math
import pickle
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError
from hal.npzfile import check_packed
from hal.regular import open_regular

Float32 = NDArray[np.float32]

ACTIVATIONS = ("ELU", "ReLU", "Tanh", "Identity")
_STORAGES = {
    "FloatStorage": np.dtype("<f4"),
    "DoubleStorage": np.dtype("<f8"),
    "HalfStorage": np.dtype("<f2"),
}


MAX_BYTES = 64_000_000
"""Of the numbers of a policy: the public ones take 1 MB."""
MAX_TREE = 1_000_000
"""Bytes of the pickled tree of modules."""


class PolicyError(OperatorError):
    """The policy cannot be used; the message says what to do."""


class Layer(NamedTuple):
    """y = activation(weight @ x + bias)."""

    weight: Float32
    """(outputs, inputs)"""
    bias: Float32
    """(outputs,)"""
    activation: str
    """One of ACTIVATIONS; Identity for none."""


class _Module:
    """A torch module: class name and whatever the pickle sets on it."""

    kind = ""

    def __init__(self) -> None:
        self.members: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise PolicyError("a module has no members: the file is damaged, fetch it again")
        self.members = state


def _rebuild_tensor(
    storage: NDArray[Any], offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: object
) -> Float32:
    if offset < 0 or any(n < 0 for n in (*size, *stride)):
        raise PolicyError("a tensor has a negative size: the file is damaged, fetch it again")
    if math.prod(size) * 4 > MAX_BYTES:
        raise PolicyError(f"a tensor of {size} is no layer of a policy: the file is damaged, fetch it again")
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if last >= len(storage):
        raise PolicyError("a tensor is longer than its storage: the file is damaged, fetch it again")
    view = np.lib.stride_tricks.as_strided(
        storage[offset:], size, tuple(step * storage.itemsize for step in stride), writeable=False
    )
    return np.array(view, np.float32)


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: Any, archive: zipfile.ZipFile, root: str) -> None:
        super().__init__(file)
        self._archive, self._root = archive, root
        self._room = MAX_BYTES

    def find_class(self, module: str, name: str) -> Any:
        if module.startswith("__torch__"):
            return type(name, (_Module,), {"kind": name})
        if module == "collections" and name == "OrderedDict":
            return dict
        if module == "torch._utils" and name == "_rebuild_tensor_v2":
            return _rebuild_tensor
        if module == "torch._utils" and name == "_rebuild_parameter":
            return lambda data, *_: data
        if module == "torch" and name in _STORAGES:
            return _STORAGES[name]
        raise PolicyError(f"the file refers to {module}.{name}: only a scripted plain MLP can be read")

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        _, dtype, key, _, count = pid
        member = self._archive.getinfo(f"{self._root}/data/{int(key)}")
        check_packed(member)
        self._room -= member.file_size
        if self._room < 0 or not isinstance(dtype, np.dtype):
            raise PolicyError(
                f"its numbers take more than {MAX_BYTES / 1e6:.0f} MB: that is no policy for this robot"
            )
        data = np.frombuffer(self._archive.read(member), dtype)
        if len(data) < count:
            raise PolicyError(f"storage {key} is cut short: the file is damaged, fetch it again")
        return data


def read_mlp(path: Path) -> list[Layer]:
    """The layers of the perceptron in `path`, first to last. Raises PolicyError."""
    try:
        with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
            entry = next((n for n in archive.namelist() if n.endswith("/data.pkl")), None)
            if entry is None:
                raise PolicyError(
                    f"{path} holds no data.pkl: export the policy with torch.jit.script and save"
                )
            check_packed(archive.getinfo(entry))
            if archive.getinfo(entry).file_size > MAX_TREE:
                raise PolicyError(
                    f"{path} is no policy: its tree of modules takes more than {MAX_TREE / 1e6:.0f} MB"
                )
            with archive.open(entry) as file:
                tree = _Unpickler(file, archive, entry.removesuffix("/data.pkl")).load()
        layers: list[Layer] = []
        _collect(tree, layers, path)
    except PolicyError:
        raise
    except FileNotFoundError as error:
        raise PolicyError(f"{path} does not exist: give the folder of a policy with --policy DIR") from error
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror}") from error
    except Exception as error:  # whatever a broken file trips zip, pickle and numpy over
        what = " ".join(str(error).split())[:200]
        raise PolicyError(f"{path} is damaged or not a TorchScript file ({what}): fetch it again") from error
    if not layers:
        raise PolicyError(f"{path} holds no linear layer: only a scripted plain MLP can be read")
    for first, second in itertools.pairwise(layers):
        if second.weight.shape[1] != first.weight.shape[0]:
            raise PolicyError(f"{path}: layers do not fit together; only a scripted plain MLP can be read")
    return layers


def _collect(node: Any, layers: list[Layer], path: Path) -> None:
    """Depth first in the order of definition: that is the order of the calls in a plain MLP."""
    if not isinstance(node, _Module):
        return
    if node.kind == "Linear":
        weight, bias = node.members.get("weight"), node.members.get("bias")
        if not isinstance(weight, np.ndarray) or weight.ndim != 2:
            raise PolicyError(f"{path}: a linear layer has no weights; fetch the file again")
        if bias is None:
            bias = np.zeros(len(weight), np.float32)
        if bias.shape != weight.shape[:1] or not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise PolicyError(f"{path}: a linear layer's numbers are not usable; fetch the file again")
        layers.append(Layer(weight, bias, "Identity"))
    elif node.kind in ACTIVATIONS:
        if layers and node.kind != "Identity":
            layers[-1] = layers[-1]._replace(activation=node.kind)
    else:
        children = [child for child in node.members.values() if isinstance(child, _Module)]
        if not children:
            raise PolicyError(
                f"{path}: a module of type {node.kind} is not supported; only Linear and {ACTIVATIONS}"
            )
        for child in children:
            _collect(child, layers, path)
