"""The nightly fuzzer: ``python tests/fuzz/loaders.py FOLDER -runs=5000000 -max_len=8192``, with atheris installed.

``python tests/fuzz/loaders.py --seeds FOLDER`` first writes a valid file of each kind and the committed corpus, which
the fuzzer then bends: its own way, and by mutations that know the formats. An input is a byte, the number of the
reader, and a file's content. ``test_targets.py`` plays some thousand of these in CI.

``python tests/fuzz/loaders.py --keep FOLDER`` adds what a night has found to the corpus, ``corpus/READER/NAME``: the
shortest files of each reader, up to five of it and 40 kB in all. NAME begins with the SHA-256 of the content.
"""

from __future__ import annotations

import hashlib
import random
import sys
from collections import Counter
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / part) for part in ("", "cli")]
with atheris.instrument_imports(include=["uavaou"]):
    from tests.fuzz.targets import CORPUS, READERS, corpus, mutated, read, seeds

NAMES = list(READERS)
MOST_BYTES, MOST_FILES = 40_000, 5  # of the corpus, and of each reader


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


def write_seeds(folder: Path) -> None:
    """Write a valid file of each kind and the committed corpus as inputs of the fuzzer."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [*seeds().items(), *((name, path.read_bytes()) for name, path in corpus())]
    for number, (name, content) in enumerate(files):
        (folder / f"{number}-{name.replace('/', '-')}").write_bytes(bytes([NAMES.index(name)]) + content)


def keep(folder: Path) -> None:
    """Add inputs of the fuzzer to the committed corpus."""
    known = {(name, path.read_bytes()) for name, path in corpus()} | set(seeds().items())
    kept = Counter(name for name, _ in known)
    left = MOST_BYTES - sum(path.stat().st_size for _, path in corpus())
    for data in sorted((path.read_bytes() for path in folder.iterdir()), key=lambda data: (len(data), data)):
        name, content = NAMES[data[0] % len(NAMES)] if data else "", data[1:]
        if content and (name, content) not in known and kept[name] <= MOST_FILES and left >= len(content):
            (CORPUS / name).mkdir(parents=True, exist_ok=True)
            (CORPUS / name / hashlib.sha256(content).hexdigest()[:12]).write_bytes(content)
            kept[name], left = kept[name] + 1, left - len(content)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--seeds"]:
        write_seeds(Path(sys.argv[2]))
    elif sys.argv[1:2] == ["--keep"]:
        keep(Path(sys.argv[2]))
    else:
        atheris.Setup(sys.argv, give, custom_mutator=bend)
        atheris.Fuzz()
