"""The one kind of file for weights: arrays and a header in safetensors, with a checksum over both.

Any reader of safetensors reads these files. Reading one runs no code and takes bounded memory. This module writes them
itself: it writes a replay of a gigabyte without a copy in memory, and raises an ``OSError`` when the disk is full.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from safetensors import safe_open

from uavaou.errors import InputError
from uavaou.fields import validated
from uavaou.files import replacing

SCHEMA = "2"
CHECKSUM = "checksum"
POLICY = "policy."  # prefix of the names of a policy's arrays
_UNSET = "0" * hashlib.sha256().digest_size * 2  # in the checksum's place while it is computed
_MOST_HEADER = 4_000_000  # bytes; a checkpoint's header has some thousand
_LETTERS = {"f": "F", "i": "I", "u": "U"}  # of the names that safetensors has for types of numbers

Arrays = dict[str, NDArray[Any]]


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
        kind = "BOOL" if array.dtype == bool else f"{_LETTERS[array.dtype.kind]}{8 * array.itemsize}"
        header[name] = {"dtype": kind, "shape": array.shape, "data_offsets": [begin, end]}
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
        with unusable(f"{path}: not a readable safetensors file"):
            if not path.exists():
                raise InputError(f"{path}: no such checkpoint")
            if not path.is_file():
                raise InputError(f"{path}: not a regular file")
            _verify(path)
            self._file = cast(Any, safe_open(path, framework="numpy"))
            self.text: dict[str, str] = self._file.metadata() or {}
            self.shapes = {name: tuple(self._file.get_slice(name).get_shape()) for name in self._file.keys()}  # noqa: SIM118

    def read(self, name: str) -> NDArray[Any]:
        """One array.

        Raises:
            InputError: the file does not hold it, or in a type that NumPy does not have.
        """
        with unusable(f"{self.path}: '{name}' cannot be read"):
            array: NDArray[Any] = self._file.get_tensor(name)
        return array

    def part(self, prefix: str) -> Arrays:
        """The arrays whose names begin with ``prefix``, by the rest of their names.

        Raises:
            InputError: an array cannot be read.
        """
        return {name.removeprefix(prefix): self.read(name) for name in self.shapes if name.startswith(prefix)}

    def digest(self, prefix: str = "") -> str:
        """SHA-256 of the arrays whose names begin with ``prefix``: names, types, shapes and values, not the text.

        Raises:
            InputError: an array cannot be read.
        """
        digest = hashlib.sha256()
        for name, array in sorted(self.part(prefix).items()):
            digest.update(f"{prefix}{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
        return digest.hexdigest()

    def json(self, name: str) -> Any:
        """An entry of the header's text, read as JSON.

        Raises:
            InputError: it is missing or is not JSON.
        """
        with unusable(f"{self.path}: not a checkpoint of this software: cannot read '{name}' of its header"):
            return json.loads(self.text[name])

    def check_holds(self, sizes: Sequence[int]) -> None:
        """Refuse to build a network that is larger than the file which is to fill it.

        Args:
            sizes: units of its layers.

        Raises:
            InputError: the file has too few numbers.
        """
        if sum(abs(a * b) for a, b in pairwise(sizes)) > sum(map(math.prod, self.shapes.values())):
            raise InputError(f"{self.path}: does not hold networks of {list(sizes)} units")


class Header(BaseModel):
    """What a file states beside its arrays, as JSON in one entry of its text."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, ser_json_inf_nan="constants")

    entry: ClassVar[str]

    def text(self) -> dict[str, str]:
        """The text for :func:`write_arrays`."""
        return {"schema": SCHEMA, self.entry: self.model_dump_json(by_alias=True)}

    @classmethod
    def read(cls, file: ArrayFile) -> Self:
        """Read what a file states.

        Raises:
            InputError: the file has no such header, or is of another schema.
        """
        content, schema = file.json(cls.entry), file.text.get("schema", "none")
        if schema != SCHEMA:
            known = f"this version reads {SCHEMA}: train again"
            raise InputError(f"{file.path}: written with checkpoint schema {schema:.20}, {known}")
        if CHECKSUM not in file.text:
            raise InputError(f"{file.path}: damaged: its checksum is missing")
        return validated(cls, content, f"{file.path}: {cls.entry}")


@contextmanager
def unusable(problem: str) -> Iterator[None]:
    """Turn the errors of a block that uses a file's content into an :class:`InputError` that states the ``problem``."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # what a stranger's file may cause is not known
        raise InputError(f"{problem} ({error})") from error


def _verify(path: Path) -> None:
    """Compare the checksum that the header states, if any, with the content."""
    with path.open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
        if size > _MOST_HEADER:
            raise InputError(f"{path}: not a readable safetensors file (a header of {size:,} bytes)")
        content = file.read(size)
        try:
            stated = str(json.loads(content)["__metadata__"][CHECKSUM])
        except (ValueError, KeyError, TypeError, RecursionError):
            return  # a file without checksum: safetensors checks the sizes, the caller the schema
        unset = content.replace(stated.encode(errors="replace"), _UNSET.encode(), 1)
        if hashlib.file_digest(file, lambda: hashlib.sha256(unset)).hexdigest() != stated:
            raise InputError(f"{path}: damaged: its content does not have the stated checksum")
