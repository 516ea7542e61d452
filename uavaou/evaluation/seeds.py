"""The seeds of missions: training, validation and evaluation never share a mission.

A light module, so that the command line can name the defaults in its help without importing the simulator.
"""

EVALUATION_SEEDS = range(10_000, 20_000)  # of the missions that results are measured on
VALIDATION_SEEDS = range(900_000, 910_000)  # of the missions that choose a training's best checkpoint
REHEARSAL_SEEDS = range(910_000, 920_000)  # of the missions that choose a policy to fly
TRAINING_SEEDS = 1_000_000  # mission seeds that one training has for its own
VALIDATION_DRAWS = range(8_000, 9_000)  # of a family, that choose the best checkpoint of a training on it

EVALUATION_SEED = EVALUATION_SEEDS.start  # of the first evaluation mission
VALIDATION_SEED = VALIDATION_SEEDS.start
MOST_EPISODES = len(EVALUATION_SEEDS)
LARGEST_SEED = 2**32 - 1  # what NumPy's and torch's global streams take


def training_seeds(seed: int) -> range:
    """The mission seeds of the training with this ``seed``, one for each mission that it plays in parallel.

    Of a training on a family, these are the numbers of the draws.
    """
    return range(TRAINING_SEEDS * (seed + 1), TRAINING_SEEDS * (seed + 2))
