"""`uavaou export --format onnx`: what it writes and refuses, and the worked example of its page."""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import Shell
from tests.documents import ROOT, blocks
from tests.onboard.policies import QUICK, lively
from uavaou import InputError, World, evaluate, load_run
from uavaou.onboard.export import FILES, write_policy
from uavaou.onboard.runner import STEPS

PAGE = ROOT / "docs" / "how-to" / "export.md"


class Drone:
    """UAV 0 of a mission as autopilot and radio of the page's loop; the others fly beside it by pilots of their own."""

    def __init__(self, world: World) -> None:
        from runner import Pilot  # type: ignore[import-not-found]  # beside the exported policy

        self.world, self.landed = world, False
        self.others = [Pilot("onboard", uav) for uav in range(1, world.scenario.uavs)]
        self.names: dict[str, Any] = {"autopilot": self, "radio": self}

    def agreed_start(self) -> float:
        return time.time()

    def rate(self, device: int) -> float:
        return float("inf") if self.world.in_range[0, 0, device] else 0.0

    def others_m(self) -> Any:
        return self.world.positions[0, 1:]

    def position(self) -> Any:
        return self.names["to_degrees"](*self.world.positions[0, 0])

    def collect(self, selected: Any) -> list[int]:
        self.selected = selected
        return np.flatnonzero(selected).tolist()

    def go_to(self, latitude: float, longitude: float, altitude: float) -> None:
        assert altitude == self.world.scenario.altitudes_m[0]
        step = (self.names["to_metres"](latitude, longitude) - self.world.positions[0, 0]) / self.names["pilot"].step
        self.move = int(np.abs(STEPS - step).sum(axis=1).argmin())
        np.testing.assert_allclose(STEPS[self.move], step, atol=1e-6)

    def exchange(self, collected: list[int]) -> Any:
        at, in_range = self.world.positions[0], self.world.in_range[0]
        decided = [
            pilot.decide(at[pilot.uav], in_range[pilot.uav], np.delete(at, pilot.uav, axis=0)) for pilot in self.others
        ]
        moves = [self.move, *(move for move, _, _ in decided)]
        self.world.step(np.array([moves]), np.array([[self.selected, *(chosen for _, _, chosen in decided)]]))
        collected_by = self.world.stepped.association.collected_by[0]
        for pilot in self.others:
            pilot.end_slot(collected_by)
        return collected_by

    def land(self) -> None:
        self.landed = self.world.done


@pytest.mark.slow
@pytest.mark.usefixtures("quick_plans")
def test_the_worked_example_flies_as_an_evaluation(
    shell: Shell, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    imported = PAGE.with_name("import.md")
    Path("valley.yaml").write_text(blocks(imported, "yaml")[0].replace("base: paper", "base: paper\nslots: 60"))
    Path("valley.csv").write_text(blocks(imported, "csv")[1])
    out = shell.done("export any-map --format onnx --scenario valley.yaml --out onboard")
    compared, *files = out.splitlines()
    assert compared == "compared with torch: 960 of 960 rows have the same action"
    assert files == [f"onboard/{name}" for name in FILES]
    (bench,) = blocks(PAGE, "python")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "runner", raising=False)
    exec(bench, {})
    own = evaluate(load_run("any-map", "valley.yaml"), "valley.yaml", episodes=1)
    assert capsys.readouterr().out == f"{own.mean_aou_slots:.2f} slots\n"
    drone, slept = Drone(World("valley.yaml", seed=10_000)), list[float]()
    monkeypatch.setattr("time.sleep", slept.append)
    (loop,) = blocks(PAGE, "py")
    exec(loop, drone.names)
    assert drone.landed
    assert drone.world.metrics().mean_aou_s[0] == own.mean_aou_s
    length = drone.world.scenario.slot_length_s
    np.testing.assert_allclose(slept, length * np.arange(1, drone.world.scenario.slots + 1), atol=length)
    monkeypatch.delitem(sys.modules, "runner")


def test_what_cannot_be_exported_is_refused(shell: Shell, tmp_path: Path) -> None:
    err = shell.refused(f"export any-map --scenario paper --out {tmp_path}/x.safetensors")
    assert err == "uavaou: --scenario: --format onnx alone writes a map\n"
    with pytest.raises(InputError, match=r"layout: resample.*--scenario"):
        write_policy(lively(scenario=QUICK.replace(layout="resample")), "mine", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_without_onnx_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.delitem(sys.modules, "uavaou.onboard.graph", raising=False)
    with pytest.raises(InputError, match=r"'onnx' is not installed: pip install 'uavaou\[onnx\]'"):
        write_policy(lively(), "mine", tmp_path / "out")
    assert not list(tmp_path.iterdir())
