"""Files from somebody else: what cannot be read is one line, and costs no memory."""

from __future__ import annotations

import contextlib
import io
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hal.errors import OperatorError
from hal.npzfile import DamagedFile, read_npy, read_npz
from hal.robots.go2w.locomotion.controllers import OURS
from hal.robots.go2w.locomotion.torchfile import PolicyError, _rebuild_tensor, read_mlp
from hal.robots.go2w.locomotion.weights import load_weights
from hal.scenes import load_scene
from mapping.elevation.files import load_into, read_cloud
from mapping.elevation.tiles import TileStore


def archive(members: dict[str, bytes], *, packed: bool = True) -> bytes:
    """A zip with these members."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return out.getvalue()


def npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    """An .npy member with any text as its header."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + data


@given(
    hnp.arrays(
        st.sampled_from(["<f4", ">f8", "i2", "u1", "?", "<U3"]), hnp.array_shapes(min_dims=0, min_side=0)
    ),
    st.booleans(),
    st.booleans(),
)
@settings(max_examples=40)
def test_what_numpy_wrote_is_read_as_numpy_does(
    tmp_path_factory: pytest.TempPathFactory, array: Any, packed: bool, by_columns: bool
) -> None:
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    array = np.asfortranarray(array) if by_columns else array
    (np.savez_compressed if packed else np.savez)(path, one=array, two=np.array("text"))
    found = read_npz(path)
    assert found["one"].dtype == array.dtype
    np.testing.assert_array_equal(found["one"], array)
    assert str(found["two"]) == "text"
    assert list(read_npz(path, only=("two",))) == ["two"]
    np.save(path.with_suffix(".npy"), array)
    np.testing.assert_array_equal(read_npy(path.with_suffix(".npy")), array)


HEADER = "{{'descr': {}, 'fortran_order': False, 'shape': {}, }}"
CRAFTED = {
    "object": npy(HEADER.format("'|O'", "(1,)"), pickle.dumps([1])),
    "record": npy(HEADER.format("[('a', '<f4')]", "(1,)"), bytes(4)),
    "longer than its bytes": npy(HEADER.format("'<f4'", "(1000000000, 1000)"), bytes(8)),
    "shorter than its bytes": npy(HEADER.format("'<f4'", "(1,)"), bytes(800)),
    "negative": npy(HEADER.format("'<f4'", "(-1, -8)"), bytes(32)),
    "no dict": npy("[]"),
    "no python": npy("{'descr': ("),
    "unclosed text": npy("{'descr': '''"),
    "deep": npy("(" * 4000),
    "shape of words": npy(HEADER.format("'<f4'", "('a',)")),
    "version": npy(HEADER.format("'<f4'", "(1,)"), bytes(4), b"\x09\x00"),
    "cut off": b"\x93NUMPY\x01\x00\xff",
    "nothing": b"",
    "shape beyond all numbers": npy(HEADER.format("'<f4'", "(" + "9" * 400 + ",)")),
}


def policy(path: Path) -> object:
    return load_weights(path)


def map_into(path: Path) -> object:
    read_cloud(path)
    return load_into(TileStore(0.04), path, 0.04, 1)


READERS: dict[str, Callable[[Path], object]] = {
    "scene": lambda path: load_scene(str(path)),
    "map": map_into,
    "policy": policy,
}


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@pytest.mark.parametrize("member", CRAFTED.values(), ids=CRAFTED)
def test_a_crafted_array_is_one_line(tmp_path: Path, reader: Callable[[Path], object], member: bytes) -> None:
    path = tmp_path / "crafted.npz"
    names = ("height", "resolution", "origin", "header", "format", "cloud")
    path.write_bytes(archive({f"{name}.npy": member for name in names}))
    with pytest.raises(OperatorError) as told:
        reader(path)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("member", CRAFTED.values(), ids=CRAFTED)
def test_a_crafted_npy_is_one_line(tmp_path: Path, member: bytes) -> None:
    path = tmp_path / "crafted.npy"
    path.write_bytes(member)
    with pytest.raises(OperatorError, match=r"^crafted.npy: not a readable") as told:
        load_scene(path, resolution=0.1)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("packed", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_what_is_packed_in_another_way_is_not_unpacked(tmp_path: Path, packed: int) -> None:
    for name, read in (("a.npz", read_npz), ("x/data.pkl", read_mlp)):
        path = tmp_path / "file.zip"
        with zipfile.ZipFile(path, "w", packed) as file:
            file.writestr(name, bytes(1000))
        with pytest.raises((DamagedFile, PolicyError), match=f"method {packed}"):
            read(path)


@pytest.fixture(scope="module")
def bomb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bomb") / "bomb.npz"
    count = 12_500_000
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for k in range(11):  # 1.1 GB of zeros in 5 MB
            with file.open(f"a{k}.npy", "w", force_zip64=True) as out:
                out.write(npy(HEADER.format("'<f8'", f"({count},)")))
                for _ in range(10):
                    out.write(bytes(8 * count // 10))
    return path


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_a_file_that_unpacks_to_gigabytes_takes_no_memory(
    bomb: Path, reader: Callable[[Path], object]
) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(OperatorError, match="GB of arrays"):
            reader(bomb)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@given(st.data())
@settings(max_examples=150)
def test_a_damaged_policy_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    whole = bytearray(OURS.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        # Most of the file is numbers, whose damage its checksum tells: the ends and the headers between are of
        # interest.
        at = data.draw(
            st.one_of(
                st.integers(0, 400),
                st.integers(len(whole) - 1200, len(whole) - 1),
                st.integers(0, len(whole) - 1),
            )
        )
        whole[at] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(len(whole) // 2, len(whole))) if data.draw(st.booleans()) else len(whole)
    path = tmp_path_factory.mktemp("policy") / "policy.npz"
    path.write_bytes(whole[:end])
    for reader in (load_weights, read_mlp):
        with contextlib.suppress(
            OperatorError
        ):  # nothing else comes out, and damage in the numbers may go unseen
            reader(path)


@given(st.binary(max_size=200))
@settings(max_examples=150)
def test_a_pickle_of_any_bytes_is_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("pt") / "policy.pt"
    path.write_bytes(archive({"x/data.pkl": data, "x/data/0": bytes(8)}))
    with pytest.raises(OperatorError):
        read_mlp(path)


def test_a_tensor_that_repeats_one_number_for_ever_is_refused() -> None:
    with pytest.raises(PolicyError, match="no layer"):
        _rebuild_tensor(np.zeros(1, np.float32), 0, (10**6, 10**6), (0, 0))


def test_too_many_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    path.write_bytes(archive({f"{k}.npy": b"" for k in range(1001)}, packed=False))
    with pytest.raises(DamagedFile, match="1001 arrays"):
        read_npz(path)
