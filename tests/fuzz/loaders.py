"""The nightly fuzzer: ``python tests/fuzz/loaders.py CORPUS -runs=5000000 -max_len=4096``, with atheris installed.

``python tests/fuzz/loaders.py --seeds CORPUS`` first writes a valid file of each kind, which the fuzzer then bends: its
own way, and by mutations that know the formats. ``test_targets.py`` plays some thousand of these in CI.
"""

from __future__ import annotations

import random
import sys
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / part) for part in ("", "cli")]
with atheris.instrument_imports(include=["uavaou"]):
    from tests.fuzz.targets import READERS, mutated, read, seeds

NAMES = list(READERS)


def give(data: bytes) -> None:
    """Give the rest of the input to the reader that its first byte names."""
    if data:
        read(NAMES[data[0] % len(NAMES)], data[1:])


def bend(data: bytes, most: int, seed: int) -> bytes:
    """A mutation that knows the format, or one of the fuzzer's own."""
    rng = random.Random(seed)
    if len(data) < 2 or rng.random() < 0.5:
        changed: bytes = atheris.Mutate(data, most)
        return changed
    return (data[:1] + mutated(NAMES[data[0] % len(NAMES)], data[1:], rng))[:most]


if __name__ == "__main__":
    if sys.argv[1:2] == ["--seeds"]:
        folder = Path(sys.argv[2])
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in seeds().items():
            (folder / name.replace("/", "-")).write_bytes(bytes([NAMES.index(name)]) + content)
    else:
        atheris.Setup(sys.argv, give, custom_mutator=bend)
        atheris.Fuzz()
