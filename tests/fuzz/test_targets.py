"""The CI-length form of the fuzzer: the same targets and mutations, the same on every machine."""

import random

import pytest

from tests.fuzz.targets import CORPUS, READERS, corpus, mutated, read, seeds
from uavaou import InputError

OF_EACH = 150  # mutations
SLOW = ("family.yaml", "study.yaml", "search/search.yaml", "run/episodes.csv")  # a tenth of them


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_bent_files_are_read_or_refused_in_one_line(name: str) -> None:
    rng, seed = random.Random(name), seeds()[name]
    for _ in range(OF_EACH // (10 if name in SLOW else 1)):
        content = mutated(name, seed, rng)
        try:
            read(name, content)
        except Exception as error:
            raise AssertionError(f"a finding in {name}: {content!r}") from error


def test_the_corpus_is_read_or_refused_in_one_line() -> None:
    files = list(corpus())
    assert len(files) == sum(path.is_file() for path in CORPUS.rglob("*"))
    assert sum(path.stat().st_size for _, path in files) < 60_000
    for name, path in files:
        try:
            read(name, path.read_bytes())
        except Exception as error:
            raise AssertionError(f"a finding: {path}") from error


@pytest.mark.parametrize(
    "name",
    [
        "onboard/policy.json",
        "onboard/mission.json",
        "scenario.yaml",
        "set.txt",
        "any.yaml",
        "plan.json",
        "rule/plan.json",
        "mission.json",
        "suite.yaml",
        "suite.csv",
        *(name for name in READERS if name.startswith("field/")),
    ],
)
def test_the_seeds_are_valid(name: str) -> None:
    try:
        (_ := seeds()[name]) and read(name, _)
    except InputError as error:
        raise AssertionError(name) from error
