"""The command line: what it refuses and how, how quick it is, and the whole way from training to figures."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from uavaou.planners import PLANNERS
from uavaou.runs.records import Display
from uavaou_cli.main import main
from uavaou_cli.overrides import parse_overrides, parse_value
from uavaou_cli.tables import WIDTH

SMALL = (
    "--set algorithm.missions=8 --set algorithm.rollout_slots=60 --set algorithm.batch_rows=240 "
    "--set algorithm.evaluate_every_slots=1000 --set algorithm.evaluation_missions=4"
)
TRAIN = f"train --scenario quickstart --quiet {SMALL}"
TINY = f"train --scenario tiny --quiet --slots 96 {SMALL.replace('rollout_slots=60', 'rollout_slots=12')}"

BAD_INPUTS = [
    # command, what the line must say
    ("trian", "did you mean 'train'?"),
    ("--verson", "did you mean '--version'?"),
    ("plot trajectores x", "did you mean 'trajectories'?"),
    ("scenarios paper", "unexpected"),
    # train
    ("train quickstart", "unexpected"),
    ("train --sed 3", "did you mean '--seed'?"),
    ("train --seed", "--seed"),
    ("train --seed x", "--seed"),
    ("train --seed -1", "--seed -1"),
    ("train --seed 99999999999", "--seed 99999999999"),
    ("train --slots 0", "--slots 0"),
    ("train --slots -5", "--slots -5"),
    ("train --slots 1.5", "--slots"),
    ("train --slots 5 --set algorithm.slots=6", "--slots and --set algorithm.slots"),
    ("train --device gpu", "did you mean 'cpu'?"),
    ("train --backend super", "did you mean 'supersuit'?"),
    ("train --algorithm mapo", "did you mean 'mappo'?"),
    ("train --scenario quikstart", "did you mean 'quickstart'?"),
    ("train --scenario nowhere.yaml", "nowhere.yaml"),
    ("train --scenario twins.yaml", "same position"),
    ("train --scenario list.yaml", "list.yaml"),
    ("train --scenario .", "unknown scenario"),
    ("train --out file", "'file"),
    ("train --out file/deeper", "'file"),
    ("train --set scenario.slots", "KEY=VALUE"),
    ("train --set scenario.slots=", "KEY=VALUE"),
    ("train --set =3", "KEY=VALUE"),
    ("train --set slots=3", "'scenario.slots' or 'algorithm.slots'"),
    ("train --set scenaro.slots=3", "did you mean 'scenario.slots'?"),
    ("train --set scenario.slot=3", "did you mean 'slots'?"),
    ("train --set scenario.bandwidth_hz.lwo=3", "did you mean 'low'?"),
    ("train --set scenario.slots.low=3", "no parts"),
    ("train --set scenario.slots=3 --set scenario.slots=4", "given twice"),
    ("train --set scenario.bandwidth_hz=3 --set scenario.bandwidth_hz.low=4", "give one of them"),
    ("train --set scenario.slots=1", "slots = 1"),
    ("train --set scenario.uavs=many", "uavs = 'many'"),
    ("train --set scenario.rate_min_bit_s=-5", "rate_min_bit_s = -5"),
    ("train --set scenario.noise_power_dbm=true", "noise_power_dbm = True"),
    ("train --set scenario.noise_power_dbm=nan", "noise_power_dbm = nan"),
    ("train --set scenario.grid_step_m=70", "does not divide"),
    ("train --set scenario.cds_m=[[0,0],[50,0],[0,0]]", "not on the grid"),
    ("train --set scenario.flight_time_budget_s=5", "take-off"),
    ("train --set scenario.bandwidth_hz.low=9e9", "must not exceed"),
    ("train --set algorithm.learning_rte=1e-4", "did you mean 'learning_rate'?"),
    ("train --set algorithm.learning_rate=-1e-4", "learning_rate = -0.0001"),
    ("train --set algorithm.name=ippo", "--algorithm"),
    ("train --set algorithm.missions=7 --set algorithm.processes=2", "divide"),
    # eval
    ("eval", "nothing to evaluate"),
    ("eval nowhere", "'nowhere' does not exist"),
    ("eval greedy", "--policy greedy"),
    ("eval file", "not a folder"),
    ("eval .", "not a run folder"),
    ("eval --policy rnadom", "did you mean 'random'?"),
    ("eval --polcy random", "did you mean '--policy'?"),
    ("eval --policy random --episodes 0", "--episodes 0"),
    ("eval --policy random --episodes -3", "--episodes -3"),
    ("eval --policy random --episodes 1e3", "--episodes"),
    ("eval --policy random --episodes 100000000", "at most 10000"),
    ("eval --policy random --seed -1", "--seed -1"),
    ("eval --policy random --action best", "--action"),
    ("eval --policy random --json file/x.json", "'file"),
    ("eval --policy random --json .", "it is a folder"),
    ("eval --policy random --json /dev/null", "not a regular file"),
    ("eval --policy random --scenario nothing", "unknown scenario"),
    ("eval --policy random --scenario twins.yaml", "same position"),
    ("eval --policy random --set scenario.slots=1", "slots = 1"),
    ("eval --policy random --set algorithm.gamma=0.9", "algorithm.gamma"),
    # plot
    ("plot figures", "uavaou study run paper"),
    ("plot figures nowhere", "'nowhere' does not exist"),
    ("plot figures .", "not a run folder"),
    ("plot trajectories", "missing argument 'RUN'"),
    ("plot trajectories nowhere", "'nowhere' does not exist"),
    ("plot trajectories nowhere --episode-seed -1", "--episode-seed -1"),
    # plan, gap
    ("plan", "missing argument 'SCENARIO'"),
    ("plan papr", "did you mean 'paper'?"),
    ("plan tiny --planner anneall", "did you mean 'anneal'?"),
    ("plan tiny --planner greedy", "unknown --planner 'greedy'"),
    ("plan tiny --time-limit 0", "--time-limit 0"),
    ("plan tiny --time-limit nan", "--time-limit nan"),
    ("plan tiny --episodes 0", "--episodes 0"),
    ("plan tiny --seed -1", "--seed -1"),
    ("plan tiny --out file", "'file"),
    ("plan tiny --set scenario.layout=resample", "new layout each mission"),
    ("plan tiny --set algorithm.gamma=0.9", "algorithm.gamma"),
    ("plan paper --planner exact --out x", "fading = rician"),
    ("plan paper --planner exact --out x --set scenario.fading=none", "4,049,460 variables, at most 120,000"),
    ("gap", "missing argument 'SCENARIO'"),
    ("gap nothing", "unknown scenario"),
    ("gap tiny nowhere", "'nowhere' does not exist"),
    ("gap tiny --set scenario.layout=resample", "the bound is that of one layout"),
    ("gap tiny --time-limit -1", "--time-limit -1"),
    # audit
    ("audit", "missing argument 'SCENARIO'"),
    ("audit papr", "did you mean 'paper'?"),
    ("audit twins.yaml", "same position"),
    ("audit paper tiny", "unexpected"),
]
BAD_INPUTS_WITH_A_RUN = [
    ("eval {run} --scenario paper", "which its network does not fit"),
    ("eval {run} --set scenario.devices=3", "which its network does not fit"),
    ("eval {run} --set algorithm.gamma=0.9", "algorithm.gamma"),
    ("eval {run} {other}", "--scenario"),
    ("eval {run} --json {run}", "it is a folder"),
    ("eval {broken}", "safetensors"),
    ("eval {fresh}", "no checkpoint yet"),
    ("plot figures {run} --out file", "'file'"),
    ("plot figures {fresh}", "episodes.csv"),
    ("plot trajectories {run} --out file/x", "'file"),
    ("plot trajectories {run} --episode-seed x", "--episode-seed"),
    ("plot trajectories {fresh}", "no checkpoint yet"),
    (TINY, "--resume"),
]


def call(capsys: pytest.CaptureFixture[str], command: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of ``uavaou <command>``, in this process."""
    capsys.readouterr()
    code = main(shlex.split(command))
    out, err = capsys.readouterr()
    return code, out, err


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file and folder below, with what it holds."""
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder but for a file in the way and two scenarios that cannot be used."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "twins.yaml").write_text("base: quickstart\ndevices: 2\ndevices_m: [[10, 10], [10, 10]]\n")
    (tmp_path / "list.yaml").write_text("- paper\n")
    return tmp_path


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which runs were trained, and some spoilt afterwards."""
    place = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        (place / "file").write_text("in the way")
        for options in ("", "--set scenario.layout_seed=1", "--seed 1", "--seed 2"):
            assert main(shlex.split(f"{TINY} {options}")) == 0
        paths = runs(place)
        (place / paths["broken"] / "checkpoints" / "best.safetensors").write_text("spoilt")
        fresh = place / paths["fresh"]
        (fresh / "episodes.csv").unlink()
        for checkpoint in (fresh / "checkpoints").iterdir():
            checkpoint.unlink()
    return place


def runs(place: Path) -> dict[str, str]:
    """The runs of ``trained`` by what they are good for, relative to its folder."""
    other = next(place.glob("results/tiny+*/*/seed-0"))
    first = next(place.glob("results/tiny/*/seed-0"))
    named = {"run": first, "other": other, "broken": first.with_name("seed-1"), "fresh": first.with_name("seed-2")}
    return {name: str(path.relative_to(place)) for name, path in named.items()}


# -- what is refused -----------------------------------------------------------------------------------


def assert_refused(capsys: pytest.CaptureFixture[str], command: str, says: str, place: Path) -> None:
    before = contents(place)
    code, out, err = call(capsys, command)
    assert code == 2, err
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("uavaou: ")
    assert says in err
    assert contents(place) == before


@pytest.mark.parametrize(("command", "says"), BAD_INPUTS)
def test_bad_input_is_one_line_and_nothing_happens(
    capsys: pytest.CaptureFixture[str], workplace: Path, command: str, says: str
) -> None:
    assert_refused(capsys, command, says, workplace)


@pytest.mark.parametrize(("command", "says"), BAD_INPUTS_WITH_A_RUN)
def test_bad_input_about_runs_is_one_line_and_nothing_happens(
    capsys: pytest.CaptureFixture[str], trained: Path, monkeypatch: pytest.MonkeyPatch, command: str, says: str
) -> None:
    monkeypatch.chdir(trained)
    assert_refused(capsys, command.format(**runs(trained)), says, trained)


def test_cuda_is_refused_where_there_is_none(
    capsys: pytest.CaptureFixture[str], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert_refused(capsys, "train --device cuda", "--device cuda", workplace)


def test_a_folder_that_cannot_be_written_is_found_first(
    capsys: pytest.CaptureFixture[str], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    for command in ("train", "eval --policy random --json x.json"):
        assert_refused(capsys, command, "Permission denied", workplace)


def test_other_errors_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("uavaou.reports.audit.audit", fail)
    with pytest.raises(ZeroDivisionError):
        main(["audit", "tiny"])


def test_the_process_reports_bad_input_as_main_does(workplace: Path) -> None:
    done = run_process("train", "--scenario", "quikstart")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


# -- quick answers -------------------------------------------------------------------------------------


def run_process(*arguments: str, after: str = "pass") -> subprocess.CompletedProcess[str]:
    code = f"import sys; from uavaou_cli.main import main; code = main(sys.argv[1:]); {after}; sys.exit(code)"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["train", "--help"], ["plot"], ["eval", "-h"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    heavy = ("torch", "matplotlib", "scipy", "numpy", "rich", "yaml")
    done = run_process(*arguments, after=f"print([m for m in {heavy} if m in sys.modules], file=sys.stderr)")
    assert (done.returncode, done.stderr) == (0, "[]\n")
    assert done.stdout
    assert all(len(line) <= WIDTH for line in done.stdout.splitlines())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    import uavaou

    assert call(capsys, "--version") == (0, f"uavaou {uavaou.__version__}\n", "")


def test_help_names_every_planner(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = call(capsys, "eval --help")
    assert all(name in out.replace("-\n", "-") for name in PLANNERS)


def test_scenarios_fit_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = call(capsys, "scenarios")
    assert (code, err) == (0, "")
    assert {"paper", "paper-table1", "quickstart", "tiny"} <= set(out.split())
    assert all(len(line) <= WIDTH for line in out.splitlines())


def test_audit_prints(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = call(capsys, "audit quickstart")
    assert (code, err) == (0, "")
    assert "errors" in out


def test_a_reader_that_stops_early_is_no_error() -> None:
    command = "import sys; from uavaou_cli.main import main; sys.exit(main(['scenarios']))"
    process = subprocess.Popen(
        [sys.executable, "-c", command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    process.wait()


# -- overrides -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7", 7),
        ("1e-4", 1e-4),
        ("-2.5", -2.5),
        ("true", True),
        ("rician", "rician"),
        ("none", "none"),
        ("[1e1, 2, [x]]", [10.0, 2, ["x"]]),
        ("{low: 15e3, high: 20000}", {"low": 15000.0, "high": 20000}),
        ("[unclosed", "[unclosed"),
    ],
)
def test_values_read_as_a_person_means_them(text: str, value: object) -> None:
    read = parse_value(text)
    assert read == value
    assert type(read) is type(value)


def test_overrides_reach_into_ranges_and_leave_the_rest() -> None:
    from uavaou.scenario import Scenario

    items = ["scenario.bandwidth_hz.low=14e3", "scenario.layout_seed=7", "algorithm.learning_rate=1e-4"]
    overrides = parse_overrides(items)
    base = Scenario.load("quickstart")
    changed = overrides.of_scenario(base).to_dict()
    assert changed == base.to_dict() | {"bandwidth_hz": {"low": 14e3, "high": 2e4}, "layout_seed": 7}
    assert overrides.of_algorithm("ippo").model_dump()["learning_rate"] == 1e-4


# -- evaluation ----------------------------------------------------------------------------------------


def test_planners_meet_the_same_missions_whatever_stands_beside_them(
    capsys: pytest.CaptureFixture[str], workplace: Path
) -> None:
    base = "eval --scenario quickstart --set scenario.layout_seed=3 --episodes 5 --json"
    for command in (f"{base} both.json --policy stay --policy random", f"{base} deep/one.json --policy random"):
        code, _, err = call(capsys, command)
        assert (code, err.startswith("wrote ")) == (0, True)
    both, one = (json.loads((workplace / name).read_text()) for name in ("both.json", "deep/one.json"))
    assert both["policies"]["random"] == one["policies"]["random"]
    assert (both["scenario"], both["episodes"], both["seed"]) == ("quickstart", 5, 10_000)
    assert list(both["policies"]) == ["stay", "random"]


def test_the_default_scenario_is_the_papers(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = call(capsys, "eval --policy stay --episodes 1 --quiet")
    assert (code, err) == (0, "")
    assert out.startswith("paper: 1 mission, seed 10000")


def test_progress_goes_to_stderr_unless_quiet(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaou_cli.progress._LINE_EVERY_S", 0)
    command = "eval --scenario tiny --policy stay --policy random --episodes 2"
    _, out, err = call(capsys, command)
    lines = err.splitlines()
    assert len(lines) == 2 * 12  # a line a slot
    assert lines[-1].startswith("100%  random: ")
    assert all("slots/s, mean AoU so far" in line and "s left" in line for line in lines)
    assert call(capsys, f"{command} --quiet") == (0, out, "")


def test_one_episode_writes_json_without_nan(capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    assert call(capsys, "eval --scenario tiny --policy stay --episodes 1 --json x.json")[0] == 0
    assert "NaN" not in (workplace / "x.json").read_text()


def test_the_table_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = call(capsys, "eval --policy stay --policy random --episodes 3 --scenario paper")
    assert all(len(line) <= WIDTH for line in out.splitlines())
    assert "violations" not in out
    assert "broke" not in out


# -- the whole way -------------------------------------------------------------------------------------


def test_a_plan_is_saved_flown_and_drawn(capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    code, out, err = call(capsys, "plan tiny --planner exact --episodes 1")
    assert code == 0
    assert "proven optimal" in out
    assert "gap 0.0%" in err
    assert all(len(line) <= WIDTH for line in out.splitlines())
    folder = workplace / "results" / "tiny" / "plan" / "exact"
    assert {path.suffix for path in folder.iterdir()} == {".json", ".png", ".pdf"}
    assert json.loads((folder / "plan.json").read_text())["planner"] == "exact"


def test_gap_orders_policies_between_bound_and_random(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, "gap tiny --episodes 1 --time-limit 1 --quiet")
    assert code == 0
    names = [line.split()[0] for line in out.splitlines()[3:] if line]
    assert names[0] == "lower"
    assert {"exact", "rolling", "greedy", "random"} < set(names)
    assert all(len(line) <= WIDTH for line in out.splitlines())


@pytest.mark.slow
def test_a_stopped_training_resumes_to_its_budget(capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    command = f"{TRAIN} --slots 4000"
    assert call(capsys, f"{command} --out whole")[0] == 0
    shown = Display.update

    def stop(self: Display, slots: int, mean_aou_s: float | None) -> None:
        if slots > 2000:
            raise KeyboardInterrupt
        shown(self, slots, mean_aou_s)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Display, "update", stop)
        code, out, err = call(capsys, f"{command} --out parts")
    assert (code, out, err.count("\n")) == (130, "", 1)
    again = err.split("to go on: uavaou ")[1]
    assert "--resume" in again
    code, out, err = call(capsys, again)
    assert (code, err) == (0, "")
    whole, parts = (next((workplace / name).glob("*/*/seed-0")) for name in ("whole", "parts"))
    metas = [json.loads((folder / "meta.json").read_text()) for folder in (whole, parts)]
    assert [meta["finished"] for meta in metas] == [True, True]
    assert metas[1]["slots"] == metas[0]["slots"] >= 4000
    assert rewards(parts) == rewards(whole)
    assert call(capsys, again)[0] == 0  # a finished one has nothing left to do
    assert rewards(parts) == rewards(whole)


def rewards(folder: Path) -> list[str]:
    """Mission, slots and reward of each training mission; wall-clock times differ."""
    rows = [line.split(",") for line in (folder / "episodes.csv").read_text().splitlines()]
    return [",".join((row[0], row[1], row[3])) for row in rows]


@pytest.mark.slow
def test_from_training_to_figures(capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    code, out, err = call(capsys, f"{TRAIN} --slots 3000")
    assert (code, err) == (0, "")
    assert "best validation: mean AoU" in out
    following = shlex.split(out.split("next:")[1])
    run = Path(following[2])
    assert f"run folder:      {run}\n" in out
    assert "slots=3000" in run.parent.name

    code, out, err = call(capsys, shlex.join([*following[1:], "--episodes", "6", "--json", "e.json"]))
    assert code == 0
    assert err.splitlines() == [f"wrote {run / 'eval' / 'default.json'}", "wrote e.json"]
    assert all(len(line) <= WIDTH for line in out.splitlines() if line != str(run))
    content = json.loads((workplace / "e.json").read_text())
    assert set(content) == {"scenario", "episodes", "seed", "policies"}
    assert list(content["policies"]) == [str(run), "random", "greedy"]
    for name, entry in content["policies"].items():
        assert ("action" in entry) == (name == str(run))
        assert len(entry["mean_aou_s"]) == len(entry["communications"]) == 6
        assert len(entry["aou_over_time_s"]) == len(entry["aou_over_time_low_s"]) == 60
        assert sum(entry["violations"].values()) == 0
    default = json.loads((run / "eval" / "default.json").read_text())
    assert default["policies"] == {"mappo": content["policies"][str(run)]} | {
        name: content["policies"][name] for name in ("random", "greedy")
    }

    for command, parts in ((f"plot figures {run}", 14), (f"plot trajectories {run} --out pictures", 4)):
        code, out, err = call(capsys, command)
        assert (code, err) == (0, "")
        assert len(out.splitlines()) == parts
        assert all((workplace / line).stat().st_size > 1000 for line in out.splitlines())


@pytest.mark.slow
def test_evaluating_elsewhere_leaves_the_run_alone(
    capsys: pytest.CaptureFixture[str], trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(trained)
    before = contents(trained)
    run = runs(trained)["run"]
    for options in ("--scenario tiny", "--set scenario.layout_seed=5"):
        code, out, err = call(capsys, f"eval {run} --episodes 2 --action sample {options}")
        assert (code, err) == (0, "")
        assert "sample" in out
    assert contents(trained) == before
