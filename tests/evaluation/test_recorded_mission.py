"""A recorded mission as a file: written, read again, refused where it is damaged."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.synthetic_study import SCENARIO, record
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import Recording, read_mission
from uavaou.scenario import Scenario


def test_a_recorded_mission_is_read_as_it_was_written(tmp_path: Path) -> None:
    mission = record(tmp_path, "tour's")
    again = read_mission(tmp_path / "mission-tour's.json")
    seen = (again.scenario, again.policy, again.training_seed, again.mission_seed)
    assert seen == (Scenario.load("tiny"), "tour's", 0, 5)
    for field in ("positions", "collected_by", "age_sum"):
        np.testing.assert_allclose(getattr(again.recording, field), getattr(mission.recording, field), rtol=1e-12)
    np.testing.assert_array_equal(again.recording.communications, mission.recording.communications)
    np.testing.assert_allclose(again.recording.layout.positions, mission.recording.layout.positions)
    np.testing.assert_array_equal(again.recording.layout.update_period, mission.recording.layout.update_period)


def change(field: str, value: Any) -> Any:
    def edit(content: dict[str, Any]) -> None:
        (content["layout"] if field in content["layout"] else content)[field] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (change("schema", 2), "schema 1"),
        (change("positions_m", [[0.0]]), "positions_m: expected an array of shape"),
        (change("age_sum_slots", "old"), "age_sum_slots = 'old'"),
        (change("collected_by", [[9] * 4] * 12), "collected_by: names UAVs outside 0 to 1"),
        (change("collected_by", [[0.5] * 4] * 12), "expected whole numbers"),
        (change("update_period_slots", [0, 1, 1, 1]), "update_period_slots: has a period below 1"),
        (change("mission_seed", None), "mission_seed"),
        (lambda content: content.pop("layout"), "layout is missing"),
        (lambda content: content["scenario"].update(slots=-1), "slots"),
    ],
)
def test_a_damaged_recording_is_an_input_error(tmp_path: Path, edit: Any, words: str) -> None:
    record(tmp_path)
    path = tmp_path / "mission-mappo.json"
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as raised:
        read_mission(path)
    assert "mission-mappo.json" in str(raised.value)


def test_nothing_pending_is_no_communication() -> None:
    layout = SCENARIO.draw_layout()
    kept = np.zeros((3, 1, 2)), np.array([[0], [0], [0]]), np.array([[0.0], [0.0], [0.0]])
    one = type(layout)(layout.positions[:1], layout.bandwidth[:1], layout.transmit_power[:1], np.array([2]))
    np.testing.assert_array_equal(Recording(*kept, one).communications[:, 0], [True, True, False])
