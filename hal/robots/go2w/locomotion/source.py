"""A learnt policy from wherever it lies: what it says of itself, and its network."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from hal.robots.go2w.locomotion.description import Description
from hal.robots.go2w.locomotion.network import Network, Perceptron, read_network
from hal.robots.go2w.locomotion.rllab import load_deployed
from hal.robots.go2w.locomotion.rlsar import load_params
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.robots.go2w.locomotion.weights import load_weights
from hal.robots.go2w.locomotion.yamlfile import first_error, read_yaml

OWN, RL_SAR, RL_LAB = "policy.yaml", "config.yaml", "deploy.yaml"
FORMS = f"{OWN} (docs/extend/policies.md), rl_sar's {RL_SAR} or unitree_rl_lab's {RL_LAB}"


def read_policy(source: Path) -> tuple[str, Description, Network]:
    """-> in whose layout it is, and both parts. `source`: an .npz of ours, a folder, or the description in it. Raises
    PolicyError."""
    if source.suffix == ".npz":
        params, layers, _ = load_weights(source)
        return "a file of ours", params.described(), Perceptron(layers)
    if source.suffix in (".onnx", ".pt"):
        raise PolicyError(
            f"{source} does not say what it sees: name its folder, or a description beside it: {FORMS}"
        )
    form, file, network = _found(source)
    if form == OWN:
        try:
            description = Description.model_validate(read_yaml(file))
        except ValidationError as error:
            raise PolicyError(f"{file}: {first_error(error)}") from error
        form = "a description of ours"
    elif form == RL_LAB:
        description = load_deployed(file)
        form = "unitree_rl_lab's layout"
    else:
        try:
            description = load_params(file.parent).described()
        except ValidationError as error:
            raise PolicyError(f"{file}: {first_error(error)}") from error
        form = "rl_sar's layout"
    path = network or _inside(file, description.network)
    return form, description, read_network(path, description.seen, len(description.joints))


def _found(source: Path) -> tuple[str, Path, Path | None]:
    """-> which description it is, its file, and its network where the layout fixes that."""
    files = (
        [source]
        if source.suffix == ".yaml"
        else [source / OWN, source / RL_SAR, source / RL_LAB, source / "params" / RL_LAB]
    )
    file = next((path for path in files if path.is_file()), None)
    if file is None:
        there = "does not exist" if not source.exists() else "holds no description of a policy"
        raise PolicyError(f"policy {source} {there}: give a folder with {FORMS}")
    if file.name != RL_LAB:
        return (RL_SAR if file.name == RL_SAR else OWN), file, None
    exported = file.parent.parent / "exported" / "policy.onnx"
    return RL_LAB, file, exported if exported.is_file() else file.parent / "policy.onnx"


def _inside(file: Path, name: str) -> Path:
    """A file beside a description. Raises PolicyError."""
    path = Path(name)
    if path.is_absolute() or ".." in path.parts:
        raise PolicyError(f"{file}: the network {name} must lie in the same folder")
    return file.parent / path
