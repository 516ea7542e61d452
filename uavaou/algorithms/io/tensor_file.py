"""Arrays and text in a safetensors file with a checksum; reading one runs no code and takes bounded memory.

Any reader of safetensors reads these files. This module writes them itself: it writes a replay of a gigabyte
without a copy in memory, and raises an ``OSError`` when the disk is full.
"""

import hashlib
import json
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from uavaou.errors import InputError
from uavaou.files import replacing

CHECKSUM = "checksum"
POLICY = "policy."  # prefix of the names of a policy's arrays
_UNSET = "0" * hashlib.sha256().digest_size * 2  # in the checksum's place while it is computed
_MOST_HEADER = 4_000_000  # bytes; a checkpoint's header has some thousand
_CHUNK = 1 << 24  # bytes
_TYPES = {
    "bool": "BOOL", "uint8": "U8", "int8": "I8", "int16": "I16", "uint16": "U16", "float16": "F16", "int32": "I32",
    "uint32": "U32", "float32": "F32", "int64": "I64", "uint64": "U64", "float64": "F64",
}  # fmt: skip


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], text: Mapping[str, str]) -> None:
    """Replace ``path`` by a file of ``arrays`` and ``text``, as a whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    # Widest types first, as in safetensors: every array then begins at a multiple of its own width.
    ordered = sorted(arrays.items(), key=lambda item: (-item[1].dtype.itemsize, item[0]))
    header: dict[str, Any] = {"__metadata__": {**text, CHECKSUM: _UNSET}}
    end = 0
    for name, array in ordered:
        begin, end = end, end + array.nbytes
        header[name] = {"dtype": _TYPES[array.dtype.name], "shape": array.shape, "data_offsets": [begin, end]}
    content = json.dumps(header).encode()
    content += b" " * (-len(content) % 8)
    with replacing(path, "wb") as file:
        digest = hashlib.sha256(content)
        file.write(len(content).to_bytes(8, "little") + content)
        for _, array in ordered:
            if array.size:
                plain = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
                digest.update(plain)
                file.write(plain)
        file.seek(8)
        file.write(content.replace(_UNSET.encode(), digest.hexdigest().encode(), 1))


class ArrayFile:
    """A safetensors file opened for reading, after a check of its checksum if it has one.

    Raises:
        InputError: the file is missing, damaged, or not a safetensors file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise InputError(f"{path}: not a regular file")
            _verify(path)
            self._file = _open(path)
            self.text: dict[str, str] = self._file.metadata() or {}
            self.shapes = {name: tuple(self._file.get_slice(name).get_shape()) for name in self._file.keys()}  # noqa: SIM118
        except FileNotFoundError as error:
            raise InputError(f"{path}: no such checkpoint") from error
        except (SafetensorError, OSError) as error:
            raise InputError(f"{path}: not a readable safetensors file ({error})") from error

    @property
    def elements(self) -> int:
        """How many numbers the file holds."""
        return sum(int(np.prod(shape)) for shape in self.shapes.values())

    def read(self, name: str) -> NDArray[Any]:
        """One array; no sound training leaves a number that is not finite.

        Raises:
            InputError: the file does not hold it, or in a type that NumPy does not have, or it is not finite.
        """
        try:
            array: NDArray[Any] = self._file.get_tensor(name)
        except (SafetensorError, TypeError, ValueError, AttributeError, KeyError) as error:
            raise InputError(f"{self.path}: '{name}' cannot be read ({error})") from error
        if array.dtype.kind == "f" and not (finite := np.isfinite(array)).all():
            raise InputError(f"{self.path}: '{name}' holds {array[~finite].flat[0]}, not finite numbers alone")
        return array

    def digest(self, prefix: str = "") -> str:
        """SHA-256 of the arrays whose names begin with ``prefix``: names, types, shapes and values, not the text.

        Raises:
            InputError: an array cannot be read.
        """
        digest = hashlib.sha256()
        for name in sorted(name for name in self.shapes if name.startswith(prefix)):
            array = self.read(name)
            digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
        return digest.hexdigest()

    def json(self, name: str) -> Any:
        """An entry of the header's text, read as JSON.

        Raises:
            InputError: it is missing or is not JSON.
        """
        try:
            return json.loads(self.text[name])
        except (KeyError, ValueError, RecursionError) as error:
            raise InputError(f"{self.path}: not a checkpoint of this software ('{name}' is missing)") from error


def _open(path: Path) -> Any:
    return safe_open(path, framework="numpy")


def _verify(path: Path) -> None:
    with path.open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
        if size > _MOST_HEADER:
            raise InputError(f"{path}: not a readable safetensors file (a header of {size:,} bytes)")
        content = file.read(size)
        try:
            stated = json.loads(content)["__metadata__"][CHECKSUM]
        except (ValueError, KeyError, TypeError, RecursionError):
            return  # a file without checksum: safetensors checks the sizes, the caller the schema
        if not isinstance(stated, str) or len(stated) != len(_UNSET):
            raise InputError(f"{path}: damaged: its checksum is not a checksum")
        digest = hashlib.sha256(content.replace(stated.encode(), _UNSET.encode(), 1))
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    if digest.hexdigest() != stated:
        raise InputError(f"{path}: damaged: its content does not have the stated checksum")
