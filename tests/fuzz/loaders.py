"""The nightly fuzzer: ``python tests/fuzz/loaders.py FOLDER EXECUTIONS``, with atheris installed.

It first writes a valid file of each kind and the committed corpus into FOLDER, then bends them: the fuzzer's own way,
and by mutations that know the formats. An input is a byte, the number of the reader, and a file's content. An execution
is one such file, read by the whole reader. No reader gets more than its share of them. ``test_targets.py`` plays some
thousand in CI.

``FOLDER.tally.json`` counts the executions of each reader. The same command goes on where it was stopped, until all
readers together have EXECUTIONS. An input that ends in anything but an answer or a refusal, or takes seconds, goes to
``FOLDER.findings``, one for each place in the code; the command then goes on, and fails at its end.

``python tests/fuzz/loaders.py --keep FOLDER`` adds what a night has found to the corpus, ``corpus/READER/NAME``: the
shortest files of each reader, up to five of it and 40 kB in all. NAME begins with the SHA-256 of the content.
"""

import hashlib
import json
import os
import random
import sys
import time
import traceback
from collections import Counter
from pathlib import Path

import atheris

sys.path[:0] = [str(Path(__file__).resolve().parents[2] / part) for part in ("", "cli")]
with atheris.instrument_imports(include=["uavaou", "uavaou_cli"]):
    from tests.fuzz.targets import CORPUS, READERS, corpus, mutated, read, seeds, settle

NAMES = list(READERS)
MOST_BYTES, MOST_FILES = 40_000, 5  # of the corpus, and of each reader
LONGEST = 8192  # bytes of an input
AHEAD = 200  # executions that a reader may have more than the one with the fewest
LONGEST_S = 5.0  # CPU time of an execution; the longest that is known takes 0.1 s
EVERY = 1000  # executions after which the tally is written


class Night:
    """The executions until there are enough of all readers."""

    def __init__(self, folder: Path, executions: int) -> None:
        self.folder, self.executions = folder, executions
        self.tally_file, self.findings = Path(f"{folder}.tally.json"), Path(f"{folder}.findings")
        before = json.loads(self.tally_file.read_text()) if self.tally_file.exists() else {}
        self.tally = Counter(dict.fromkeys(NAMES, 0) | before)
        self.pool: dict[str, list[bytes]] = {name: [] for name in NAMES}
        for data in (path.read_bytes() for path in folder.iterdir()):
            if data:
                self.pool[NAMES[data[0] % len(NAMES)]].append(data[1:])

    @property
    def left(self) -> int:
        return max(self.executions - self.tally.total(), 0)

    def give(self, data: bytes) -> None:
        """Give the rest of the input to the reader that its first byte names."""
        name = NAMES[data[0] % len(NAMES)] if data else NAMES[0]
        began = time.process_time()
        try:
            read(name, data[1:])
            if (took_s := time.process_time() - began) > LONGEST_S:
                raise TimeoutError(f"{took_s:.1f} s of CPU time")
        except Exception as error:
            self.keep_finding(name, data[1:], error)
        self.tally[name] += 1
        if not self.tally.total() % EVERY or not self.left:
            self.write_tally()
        if not self.left and self.findings.exists():
            raise RuntimeError(f"findings: {self.findings}")

    def write_tally(self) -> None:
        partial = self.tally_file.with_suffix(".partial")
        partial.write_text(json.dumps(self.tally, indent=1))
        os.replace(partial, self.tally_file)

    def keep_finding(self, name: str, content: bytes, error: Exception) -> None:
        """Keep the first input of each place at which a reader fails, with the traceback."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{name.replace('/', '-')}-{type(error).__name__}-{Path(last.filename).stem}-{last.lineno}"
        if not (file := self.findings / place).exists():
            self.findings.mkdir(exist_ok=True)
            file.write_bytes(content)
            Path(f"{file}.txt").write_text("".join(traceback.format_exception(error)))
            print(f"a finding: {file}", flush=True)

    def bend(self, data: bytes, most: int, seed: int) -> bytes:
        """A mutation that knows the format, or one of the fuzzer's own.

        Where a reader has had more than its share, a file of the reader with the fewest executions is bent instead.
        """
        rng = random.Random(seed)
        name = NAMES[data[0] % len(NAMES)] if data else NAMES[0]
        content = data[1:]
        fewest = min(NAMES, key=self.tally.__getitem__)
        if self.tally[name] > self.tally[fewest] + AHEAD:
            name, content = fewest, rng.choice(self.pool[fewest])
        content = atheris.Mutate(content, most - 1) if rng.random() < 0.5 else mutated(name, content, rng)
        return (bytes([NAMES.index(name)]) + content)[:most]


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
    if sys.argv[1:2] == ["--keep"]:
        keep(Path(sys.argv[2]))
    else:
        place = Path(sys.argv[1])
        write_seeds(place)
        settle()
        night = Night(place, int(sys.argv[2]))
        # Reading the folder counts too; beyond its files the fuzzer wants at least one run.
        settings = [f"-runs={night.left}", f"-max_len={LONGEST}", f"-artifact_prefix={place}."]
        atheris.Setup([sys.argv[0], str(place), *settings], night.give, custom_mutator=night.bend)
        if night.left:
            atheris.Fuzz()
