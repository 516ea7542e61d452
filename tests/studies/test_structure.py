"""The structure of trainings: what is held, who strays, and when a comparison is decided."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import hypergeom

from uavaou import InputError
from uavaou.statistics.counts import fisher, is_decided
from uavaou.studies.folder import PartKey
from uavaou.studies.results import read_study
from uavaou.studies.structure import held_devices, strays, structures
from uavaou.studies.study import Study

RESULTS = Path(__file__).resolve().parents[2] / "results" / "studies"


def test_the_strays_on_paper_are_those_that_are_known() -> None:
    results = read_study(RESULTS / "paper")
    assert results.settings["held"] == [22]
    found = structures(results)
    assert all(one.strays == (22 not in one.held) for one in found.values())
    assert [key.seed for key, one in found.items() if one.strays and key.variant == "mappo"] == [0, 1, 2, 5, 8]
    counts = {name: strays(found, name, "paper")[0] for name in results.algorithms}
    assert counts == {
        "mappo": 5, "ippo": 10, "vdn": 10, "vdn with value": 4, "qmix": 1, "mappo, four candidates": 1,
        "ippo, four candidates": 8, "qmix, four candidates": 0,
    }  # fmt: skip


def test_trainings_that_hold_nothing_are_no_majority() -> None:
    results = read_study(RESULTS / "paper")
    del results.settings["held"]
    for key in [key for key in results.parts if key.variant not in ("ippo", "vdn", "qmix")]:
        del results.parts[key]
    found = structures(results)
    assert sum(not one.held for one in found.values()) > len(found) / 2
    assert [strays(found, name, "paper") for name in ("ippo", "vdn", "qmix")] == [(10, 10), (10, 10), (1, 10)]


def test_stated_devices_take_the_place_of_the_commonest() -> None:
    results = read_study(RESULTS / "paper")
    results.settings["held"] = [18]
    found = structures(results)
    assert {key for key, one in found.items() if one.strays} == {
        key for key, one in found.items() if 18 not in one.held
    }
    assert not any(one.strays for key, one in found.items() if key.variant in ("mappo", "qmix"))
    del results.settings["held"]  # the commonest set is that of three devices
    assert {one.held for one in structures(results).values() if not one.strays} == {(17, 18, 22)}


def test_trainings_far_behind_the_best_of_their_algorithm_stray_where_that_is_stated() -> None:
    results = read_study(RESULTS / "paper")
    del results.settings["held"]
    means = {key: float(results.cell(key, "mean_aou_slots")) for key in results.parts if key.seed is not None}
    kinds = results.algorithms  # variant -> algorithm
    for behind in (0.05, 0.1):
        results.settings["behind"] = behind
        least = {
            kind: min(mean for key, mean in means.items() if kinds[key.variant] == kind) for kind in kinds.values()
        }
        far = {key for key, mean in means.items() if mean > (1 + behind) * least[kinds[key.variant]]}
        found = structures(results)
        assert {key for key, one in found.items() if one.strays} == far
        assert PartKey("mappo", "paper", 1) in far
        assert PartKey("qmix", "paper", 7) not in far


def test_variants_of_one_algorithm_are_measured_by_the_best_of_all() -> None:
    results = read_study(RESULTS / "strays-fresh")
    mean = {key: float(results.cell(key, "mean_aou_slots")) for key in results.parts if key.seed is not None}
    least = {place: min(one for key, one in mean.items() if key.scenario == place) for place in results.scenarios}
    found = structures(results)
    assert {key for key, one in found.items() if one.strays} == {
        key for key, one in mean.items() if one > 1.1 * least[key.scenario]
    }
    four = PartKey("four candidates", "layout 9", 4)
    assert found[four].strays
    assert mean[four] < 1.1 * min(one for key, one in mean.items() if key[:2] == four[:2])  # but within 10 % of its own


def test_only_devices_of_the_shortest_period_are_held() -> None:
    devices: dict[str, Any] = {
        "device": np.arange(4),
        "update_period_slots": np.array([2, 2, 4, 2]),
        "communications": np.array([46.0, 44.0, 25.0, 45.0]),  # of 50, 50, 25 and 50 in 100 slots
    }
    assert held_devices(devices, 100) == (0, 3)


def test_fishers_test_is_that_of_the_hypergeometric_distribution() -> None:
    for first, second in ((5, 0), (3, 1), (0, 0)):
        chances = hypergeom(40, first + second, 20).pmf(np.arange(first + second + 1))
        assert fisher(first, 20, second, 20) == pytest.approx(chances[chances <= chances[first] * (1 + 1e-7)].sum())


def test_a_comparison_is_decided_when_nothing_can_change_it() -> None:
    assert not is_decided(0, 0, 0, 0, 20)
    assert is_decided(3, 3, 0, 3, 3)  # never significant
    assert is_decided(0, 18, 0, 18, 20)
    assert not is_decided(4, 16, 0, 16, 20)  # 5 of 20 against 0 has p = 0.047
    assert is_decided(12, 12, 0, 12, 16)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("held: [25]\nreference: mappo", "held = .25.: expected devices from 0 to 24"),
        ("until_decided: true\nreference: mappo", "needs held and reference"),
        ("until_decided: true\nheld: [22]", "needs held and reference"),
        ("held: []", "held"),
        ("held: [22]\nbehind: 0.1", "behind = 0.1: beside held"),
        ("behind: 0", "behind"),
    ],
)
def test_a_rule_that_cannot_decide_is_refused(tmp_path: Path, lines: str, words: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"seeds: 2\nscenarios: [paper]\nvariants: {{mappo: {{}}, ippo: {{}}}}\n{lines}\n")
    with pytest.raises(InputError, match=words):
        Study.load(file)


def test_no_training_is_measured_by_the_best_where_layouts_change(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    place = "{scenario: paper, set: {layout: resample}, name: drawn}"
    file.write_text(f"seeds: 2\nscenarios: [{place}]\nvariants: {{mappo: {{}}}}\nbehind: 0.1\n")
    with pytest.raises(InputError, match="expected scenarios of fixed layouts alone"):
        Study.load(file)
