"""CDR, little-endian: one generated function per type and direction.

rosbags packs value by value; it is the oracle of the tests. Here neighbouring values of fixed size, those of nested
messages too, pass through one `struct`. That takes a third of the time, and poses and IMU samples come 200 times a
second.

CDR aligns each value by its own size, counted from the end of the header. After a string or a list nothing is known
of the position. So a run of fixed values ends there, and where a value needs a coarser alignment than the start of
its run has."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype, Typestore
from rosbags.serde import SerdeError

HEADER = b"\0\1\0\0"
"""Plain CDR, little-endian."""
LONGEST_LIST = 2**30
"""Values of a list; more is taken for broken bytes."""
_CODES = {
    "bool": "?", "byte": "b", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_COUNT = Struct("<I")


class Codec:
    """Messages of the types of a store to bytes and back. Functions are made when a type is first met."""

    def __init__(self, store: Typestore) -> None:
        self._store: Any = store
        self._made: dict[str, tuple[Callable[..., int], Callable[..., tuple[Any, int]]]] = {}

    def encode(self, message: Any) -> bytes:
        """Header and values of a message."""
        parts = [HEADER]
        self.functions(message.__msgtype__)[0](parts, 0, message)
        return b"".join(parts)

    def decode(self, payload: bytes, name: str) -> Any:
        """The message of type `name`; arrays are read-only views. Raises SerdeError and what broken values raise."""
        data = bytes(payload[4:])  # the values begin where numpy has its arrays aligned
        message, end = self.functions(name)[1](data, 0)
        if end + 3 < len(data):
            raise SerdeError(f"{len(data) - end} bytes too many")
        return message

    def functions(self, name: str) -> tuple[Callable[..., int], Callable[..., tuple[Any, int]]]:
        """Of a type: `write(parts, pos, message) -> pos` and `read(data, pos) -> message, pos`."""
        if name not in self._made:
            source = _Source(self, name)
            text = "\n    ".join(["def write(parts, pos, message):", *source.write, "return pos", ""])
            text += "\n    ".join(["\ndef read(data, pos):", *source.read, f"return {source.made}, pos"])
            exec(text, source.names)
            self._made[name] = source.names["write"], source.names["read"]
        return self._made[name]

    def kind(self, name: str) -> type:
        """Class of a type."""
        return self._store.types[name]  # type: ignore[no-any-return]

    def fields(self, name: str) -> list[tuple[str, Any]]:
        """Name and description of the fields of a type."""
        return self._store.fielddefs[name][1]  # type: ignore[no-any-return]

    def align(self, desc: Any) -> int:
        """Bytes by which the first value of a field is aligned."""
        node, detail = desc
        if node == Nodetype.NAME:
            return self.align(self.fields(detail)[0][1])
        if node == Nodetype.ARRAY:
            return self.align(detail[0])
        return Struct(_CODES.get(detail[0], "I")).size if node == Nodetype.BASE else 4


class _Source:
    """Lines of the two functions of a type, and the names that they use."""

    def __init__(self, codec: Codec, name: str) -> None:
        self._codec = codec
        self.names: dict[str, Any] = {
            "frombuffer": np.frombuffer,
            "zeros": [bytes(n) for n in range(8)],
            "SerdeError": SerdeError,
        }
        self.names |= {
            "fixed": _fixed,
            "listed": _listed,
            "count": _COUNT.pack,
            "counted": _COUNT.unpack_from,
        }
        self.write: list[str] = []
        self.read: list[str] = []
        self._known = codec.align((Nodetype.NAME, name))
        """What the position is a multiple of, at the start of the present run."""
        self._format, self._size = "<", 0
        """Of the present run."""
        self._given: list[str] = []
        self._taken: list[str] = []
        """Names of its values in `write` and in `read`."""
        self.made = self._message(name, "message")
        """Expression for the message that was read."""
        self._end_run()

    def _name(self, value: Any = None) -> str:
        name = f"v{len(self.names)}"
        self.names[name] = value
        return name

    def _message(self, name: str, path: str) -> str:
        """Pass the fields of the message `path`; the expression that makes it from what was read."""
        kind = self._name(self._codec.kind(name))
        return f"{kind}({', '.join(self._field(desc, f'{path}.{field}') for field, desc in self._codec.fields(name))})"

    def _field(self, desc: Any, path: str) -> str:
        node, detail = desc
        if node == Nodetype.NAME:
            return self._message(detail, path)
        if node == Nodetype.BASE:
            if detail[0] == "string":
                return self._string(path)
            return self._fixed(_CODES[detail[0]], self._codec.align(desc), path)
        (inner, base), length = detail
        if inner == Nodetype.BASE and base[0] != "string":
            dtype = np.dtype(_CODES[base[0]])
            held = self._name(dtype)
            if node == Nodetype.SEQUENCE:
                return self._numbers(path, held, dtype.itemsize)
            size = length * dtype.itemsize
            out = self._fixed(f"{size}s", dtype.itemsize, f"fixed({path}, {length}, {size})", size)
            return f"frombuffer({out}, {held})"
        if node == Nodetype.ARRAY:
            raise NotImplementedError(f"{path}: an array of messages or strings")
        return self._strings(path) if inner == Nodetype.BASE else self._messages(path, base)

    # --- values of fixed size ---------------------------------------------------------------------------------------
    def _fixed(self, code: str, align: int, value: str, size: int = 0) -> str:
        """One more value in the present run, or in a new one where its place in this one is not known."""
        if align > self._known:
            self._end_run()
            self._align(align)
            self._known = align
        pad = -self._size % align
        self._format += "x" * pad + code
        self._size += pad + (size or align)
        self._given.append(value)
        self._taken.append(self._name())
        return self._taken[-1]

    def _align(self, align: int, indent: str = "") -> None:
        self.write += [
            indent + f"parts.append(zeros[-pos & {align - 1}])",
            indent + f"pos += -pos & {align - 1}",
        ]
        self.read.append(indent + f"pos += -pos & {align - 1}")

    def _end_run(self) -> None:
        if not self._size:
            return
        run = Struct(self._format)
        self.write += [
            f"parts.append({self._name(run.pack)}({', '.join(self._given)}))",
            f"pos += {self._size}",
        ]
        self.read += [
            f"{', '.join(self._taken)}, = {self._name(run.unpack_from)}(data, pos)",
            f"pos += {self._size}",
        ]
        while self._size % self._known:
            self._known //= 2
        self._format, self._size, self._given, self._taken = "<", 0, [], []

    # --- values of any size -----------------------------------------------------------------------------------------
    def _string(self, path: str) -> str:
        text = self._name()
        self.write.append(f"{text} = {path}.encode()")
        size = self._fixed("I", 4, f"len({text}) + 1")
        self._end_run()
        self.write += [f"parts += {text}, zeros[1]", f"pos += len({text}) + 1"]
        self._read_string(text, size)
        self._known = 1
        return text

    def _read_string(self, text: str, size: str, indent: str = "") -> None:
        self.read += [
            indent + f"end = pos + {size}",
            indent + f"if {size} < 1 or end > len(data) or data[end - 1]:",
            indent + "    raise SerdeError(f'no string at {pos}')",
            indent + f"{text} = data[pos:end - 1].decode()",
            indent + "pos = end",
        ]

    def _length(self, path: str, least: int) -> str:
        """Pass the length of a list whose values have at least that many bytes; its name in `read`."""
        n = self._fixed("I", 4, f"len({path})")
        self._end_run()
        self.read += [
            f"if pos + {n} * {least} > len(data) or {n} > {LONGEST_LIST}:",
            f"    raise SerdeError(f'no list of {{{n}}} at {{pos}}')",
        ]
        return n

    def _numbers(self, path: str, dtype: str, size: int) -> str:
        n = self._length(path, size)
        if size > self._known:
            self.write.append(f"if len({path}):")
            self.read.append(f"if {n}:")
            self._align(size, "    ")
        self.write += [f"parts.append(listed({path}, {size}))", f"pos += {size} * len({path})"]
        values = self._name()
        self.read += [f"{values} = frombuffer(data, {dtype}, {n}, pos)", f"pos += {size} * {n}"]
        self._known = min(size, 4)
        return values

    def _strings(self, path: str) -> str:
        n, values = self._length(path, 5), self._name()
        self.write += [
            f"for item in {path}:",
            "    text = item.encode()",
            "    parts += zeros[-pos & 3], count(len(text) + 1), text, zeros[1]",
            "    pos += (-pos & 3) + len(text) + 5",
        ]
        self.read += [
            f"{values} = []",
            f"for _ in range({n}):",
            "    pos += -pos & 3",
            "    size, = counted(data, pos)",
            "    pos += 4",
        ]
        self._read_string("text", "size", "    ")
        self.read.append(f"    {values}.append(text)")
        self._known = 1
        return values

    def _messages(self, path: str, name: str) -> str:
        n, values = self._length(path, 1), self._name()
        write, read = (self._name(function) for function in self._codec.functions(name))
        self.write.append(f"for item in {path}:")
        self.read += [f"{values} = []", f"for _ in range({n}):"]
        self._align(self._codec.align((Nodetype.NAME, name)), "    ")
        self.write.append(f"    pos = {write}(parts, pos, item)")
        self.read += [f"    item, pos = {read}(data, pos)", f"    {values}.append(item)"]
        self._known = 1
        return values


def _fixed(values: Any, length: int, size: int) -> bytes:
    """Bytes of an array of fixed length."""
    if len(values) != length or values.nbytes != size:
        raise SerdeError(f"{len(values)} values of {values.dtype}: expected {length} in {size} bytes")
    return values.tobytes()  # type: ignore[no-any-return]


def _listed(values: Any, size: int) -> memoryview:
    """Bytes of a list of numbers of `size` bytes."""
    if values.nbytes != len(values) * size:
        raise SerdeError(f"values of {values.dtype}: expected {size} bytes each")
    return values.data  # type: ignore[no-any-return]
