"""Training, validation and evaluation never share a mission."""

from itertools import combinations

from annotated_types import Le
from hypothesis import given
from hypothesis import strategies as st

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.evaluation.seeds import EVALUATION_SEEDS, VALIDATION_SEEDS, training_seeds
from uavaou_cli.options import LARGEST_SEED

SEEDS = st.integers(0, LARGEST_SEED)


def most(field: str) -> int:
    """The largest value that a setting may have."""
    bounds = [item.le for item in AlgorithmConfig.model_fields[field].metadata if isinstance(item, Le)]
    return min(bound for bound in bounds if isinstance(bound, int))


@given(first=SEEDS, second=SEEDS)
def test_the_seed_ranges_are_disjoint_for_every_training_seed(first: int, second: int) -> None:
    trainings = [training_seeds(seed) for seed in sorted({first, second})]
    for one, other in combinations([EVALUATION_SEEDS, VALIDATION_SEEDS, *trainings], 2):
        assert one.stop <= other.start or other.stop <= one.start


def test_each_range_holds_all_missions_that_may_be_asked_of_it() -> None:
    assert most("missions") <= len(training_seeds(0))
    assert most("evaluation_missions") <= len(VALIDATION_SEEDS)
