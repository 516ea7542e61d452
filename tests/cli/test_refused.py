"""Bad input: one line that names it, exit code 2, and nothing written; a bug keeps its traceback."""

from pathlib import Path

import pytest

from tests.cli.commands import TINY, Shell, contents, run_process, runs
from uavaou.errors import nearest_path
from uavaou_cli.main import main

VDN = "train --algorithm vdn --set algorithm"
BAD_INPUTS = [
    # command, what the line must say
    ("trian", "did you mean 'train'?"),
    ("--verson", "did you mean '--version'?"),
    ("plot trajectores x", "did you mean 'trajectories'?"),
    ("scenarios paper", "unexpected"),
    # train
    ("train quickstart paper", "unexpected"),
    ("train --sed 3", "did you mean '--seed'?"),
    ("train --seed", "--seed"),
    ("train --family anny", "did you mean 'any'?"),
    ("train --family any --scenario paper", "--family and --scenario"),
    ("train --family any --set scenario.slots=5", "a family draws its scenarios"),
    ("train --family any --set algorithm.network=mlp", "network: set"),
    ("train --family any --backend supersuit", "a family needs backend 'batched'"),
    ("train --from nowhere", "run folder 'nowhere' does not exist"),
    ("train --from file --algorithm vdn", "--from and --algorithm"),
    ("train --continue nowhere --slots 5", "run folder 'nowhere' does not exist"),
    ("train --continue file --config file", "--continue and --config"),
    ("train --continue '' --slots 5", "RUN is empty"),
    ("fly tiny --policy bestfirst", "did you mean 'best-first'?"),
    ("fly tiny --policy ''", "RUN is empty"),
    ("fly tiny --knows shred", "unknown --knows 'shred'; did you mean 'shared'?"),
    ("fly tiny --policy best-first --knows shared", "knows everything in flight, which --knows shared does not allow"),
    ("fly tiny --policy stay --json found.json", "--json found.json: holds what a rehearsal has found"),
    ("fly tiny --json .", "cannot write '.': it is a folder"),
    ("eval --policy greedy --knows local --scenario tiny", "'greedy' knows everything in flight"),
    ("eval --suite uavs --policy stay --knows local", "a suite says itself what policies know"),
    ("replay greedy --scenario tiny --knows local", "'greedy' knows everything in flight"),
    ("replay stay --scenario tiny --slots 5", "--slots 5: is for films"),
    ("fly tiny --set algorithm.gamma=1", "only scenario.* can be set here"),
    ("fly tiny --out ''", "--out is empty: expected a path"),
    ("plot suite --out=", "--out is empty: expected a path"),
    ("fly tiny --policy typo/", "run folder 'typo' does not exist"),
    ("train --slots 5 --set algorithm.slots=6", "--slots and --set algorithm.slots"),
    ("train --device gpu", "did you mean 'cpu'?"),
    ("train --backend super", "did you mean 'supersuit'?"),
    ("train --algorithm mapo", "did you mean 'mappo'?"),
    ("train --scenario quikstart", "did you mean 'quickstart'?"),
    ("train --scenario outside.yaml", "outside the area"),
    ("train --scenario list.yaml", "list.yaml"),
    ("train --scenario .", "unknown scenario"),
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
    ("train --set scenario.noise_power_dbm=true", "noise_power_dbm = True"),
    ("train --set scenario.noise_power_dbm=nan", "noise_power_dbm = 'nan'"),
    ("train --set scenario.noise_power_dbm=.nan", "noise_power_dbm = nan"),
    ("train --set 'scenario.slots=!!int foo'", "--set scenario.slots = '!!int foo': the tag !!int is not read"),
    ("train --set scenario.slots=010", "write 10 or 8"),
    ("train --set 'scenario.bandwidth_hz={low: 1, low: 2}'", "the key 'low' is given twice"),
    ("train --set scenario.cds_m=[[0,0", "--set scenario.cds_m = '[[0,0': not valid YAML"),
    ("train --set scenario.cds_m=[[0,0],[50,0],[0,0]]", "not on the grid"),
    ("train --set algorithm.learning_rte=1e-4", "did you mean 'learning_rate'?"),
    ("train --set algorithm.learning_rate=-1e-4", "learning_rate = -0.0001"),
    ("train --set algorithm.plan_slots=-1", "plan_slots = -1: must be greater than or equal to 0"),
    ("train --family any --set algorithm.map_plan_slots=-1", "map_plan_slots = -1"),
    ("train --set algorithm.critic_rollouts=-1", "critic_rollouts = -1"),
    (f"{VDN}.slots_per_update=48", "slots_per_update = 48: must divide missions = 64, or be a multiple"),
    (f"{VDN}.replay_slots=100", "replay_slots = 100: must be more than n_step * missions = 192"),
    (f"{VDN}.replay_slots=100000000000", "GB, this machine has"),
    (f"{VDN}.epsilon_fraction=0", "epsilon_fraction"),
    (f"{VDN}.target_fraction=2", "target_fraction"),
    (f"{VDN}.mixer_width=8", "mixer_width"),
    ("train --algorithm mappo-family", "observation = 'mixed'"),
    ("train --set algorithm.name=ippo", "--algorithm"),
    ("train --set algorithm.missions=7 --set algorithm.processes=2", "divide"),
    # eval
    ("eval", "nothing to evaluate"),
    ("eval nowhere", "'nowhere' does not exist"),
    ("eval fil", "did you mean 'file'?"),
    ("eval greedy", "--policy greedy"),
    ("eval file", "not a folder"),
    ("eval .", "not a run folder"),
    ("eval --policy rnadom", "did you mean 'random'?"),
    ("eval --polcy random", "did you mean '--policy'?"),
    ("eval --policy random --episodes 100000000", "at most 10000"),
    ("eval --policy random --out /dev/null", "not a regular file"),
    ("eval --policy random --set algorithm.gamma=0.9", "algorithm.gamma"),
    # a circle of symbolic links
    ("eval circle", "'circle' does not exist"),
    ("plot figures circle", "'circle' does not exist"),
    ("fly tiny --policy circle", "circle"),
    ("tune --seconds 1 --from circle", "circle"),
    ("train --config circle", "circle: cannot be read"),
    ("train --from circle", "'circle' does not exist"),
    ("train --continue circle", "'circle' does not exist"),
    ("train --out circle", "cannot write to 'circle"),
    ("train --scenario ./circle", "circle: cannot be read"),
    # plot
    ("plot figures", "uavaou study run paper"),
    ("plot figures nowhere", "'nowhere' does not exist"),
    ("plot figures fil", "did you mean 'file'?"),
    ("plot suite fil", "did you mean 'file'?"),
    ("replay ./fil", "did you mean 'file'?"),
    ("plot figures .", "not a run folder"),
    ("plot trajectories", "missing argument 'RUN'"),
    ("plot trajectories nowhere", "'nowhere' does not exist"),
    # plan, gap
    ("plan", "missing argument 'SCENARIO'"),
    ("plan papr", "did you mean 'paper'?"),
    ("plan tiny --planner anneall", "did you mean 'anneal'?"),
    ("plan tiny --planner greedy", "unknown --planner 'greedy'"),
    ("plan tiny --set scenario.layout=resample", "new layout each mission"),
    ("plan paper --planner exact --out x", "fading = rician"),
    ("plan paper --planner exact --out x --set scenario.fading=none", "4,049,460 variables, at most 120,000"),
    ("gap tiny nowhere", "'nowhere' does not exist"),
    ("gap tiny --set scenario.layout=resample", "the bound is that of one layout"),
    ("gap tiny --certificate . --quiet", "cannot write '.': it is a folder"),
    # a scenario, as SCENARIO or --scenario
    ("gap --scenario tiny quickstart", "'quickstart' is a scenario, and arguments are runs here"),
    ("gap --scenario tiny nowhere", "'nowhere' does not exist"),
    ("eval paper --policy greedy", "'paper' is a scenario, and arguments are runs here: write --scenario paper"),
    ("replay paper greedy", "'paper' is a scenario, and arguments are runs here: write --scenario paper"),
    ("eval list.yaml --policy greedy", "write --scenario list.yaml"),
    ("plan tiny --scenario paper", "SCENARIO 'tiny' and --scenario paper: give one of them"),
    ("fly", "missing argument 'SCENARIO'"),
    ("train papr", "did you mean 'paper'?"),
    ("train tiny --scenario tiny", "SCENARIO 'tiny' and --scenario tiny: give one of them"),
    ("train tiny --family any", "--family and --scenario"),
    ("train mappo", "'mappo' is an algorithm, and the argument is a scenario: write --algorithm mappo"),
    ("train any", "write --family any"),
    ("train .", "--from . begins with its weights"),
    ("tune tiny --scenario tiny --seconds 1", "give one of them"),
    # a map of devices in place of a scenario
    ("audit map.csv", "map.csv is a table of devices and no scenario"),
    ("audit ./map.csv", "under devices_csv, write --set scenario.devices_csv=map.csv, or make one with uavaou import"),
    ("train --scenario map.csv", "no scenario"),
    ("eval map.csv", "no scenario"),
    ("replay greedy map.csv", "no scenario"),
    ("audit map.geojson", "map.geojson is GeoJSON and no scenario: uavaou import map.geojson makes one of it"),
    ("plan map.yaml", "map.yaml is GeoJSON and no scenario"),
    ("fly none.csv", "'none.csv' does not exist"),
    ("audit tiny --set scenario.devices_csv=map.geojson", "map.geojson: is GeoJSON, expected a CSV table"),
    ("audit tiny --set scenario.devices_csv=map.csv", "map.csv: line 2 = [900, 10]: outside the area"),
    # import
    ("import", "missing argument 'FILE'"),
    ("import none.csv", "none.csv: cannot be read: No such file"),
    ("import list.yaml", "no positions found"),
    ("import map.csv --radio zigbe", "unknown --radio 'zigbe'"),
    ("import map.csv --station 46", "--station 46: expected 2 numbers with commas between, such as 46.1012,7.2210"),
    ("import map.csv --endurance soon", "--endurance soon: expected a number of min"),
    ("import map.csv --speed 3kg", "--speed 3kg: expected a speed"),
    ("import map.csv --uavs 0", "--uavs 0: must be at least 1"),
    ("import map.csv --out list.yaml", "'list.yaml' is not a folder"),
    ("fly map.csv --crs EPSG:1 --seconds 1", "'EPSG:1': no coordinate reference system"),
    ("fly tiny --uavs 4", "--uavs is for a map file, and 'tiny' is a scenario: --set scenario.uavs=4"),
    # audit
    ("audit outside.yaml", "outside the area"),
    ("audit paper tiny", "unexpected"),
    ("audit tiny --set algorithm.gamma=0.9", "only scenario.* can be set here"),
    # tune
    ("tune", "give --seconds S or --slots N"),
    ("tune --seconds 3 --slots 4", "one of them"),
    ("tune --slots 5 --algorithm mapo", "did you mean 'mappo'?"),
    ("tune --slots 5 --algorithm iql", "no search space comes with 'iql'"),
    ("tune --search locl", "unknown search 'locl'"),
    ("tune --search local --slots 5", "--search and --slots"),
    ("tune --slots 5 --algorithm iql --set algorithm.network=set", "no search space comes with 'iql-set' (with"),
    ("tune --slots 5 --space file", "expected a mapping"),
    ("tune --slots 5 --set algorithm.slots=9", "the search sets it itself"),
    ("tune --slots 5 --set algorithm.processes=2", "the search sets it itself"),
    ("tune --slots 5 --set algorithm.gamma=2", "gamma = 2"),
    ("tune --slots 5 --top 3", "add --from DIR"),
    ("tune --slots 5 --from nowhere", "'nowhere' holds no search"),
    ("tune --slots 5 --from . --trials 3", "--trials and --from"),
    ("tune --slots 5 --from . --set algorithm.gamma=0.9", "taken as they are"),
    # study
    ("study run papr", "did you mean 'paper'?"),
    ("study rum", "did you mean 'run'?"),
    ("study run smoke --engine locl", "did you mean 'local'?"),
    ("study run smoke --address auto", "--engine ray"),
    ("study run nowhere.yaml", "nowhere.yaml"),
    ("train --config nowhere.yaml", "nowhere.yaml"),
    ("train --config x.yaml --slots 300", "--config and --slots"),
    ("train --config x.yaml --set algorithm.gamma=0.5", "--config and --set"),
    ("runs --out results", "holds no training"),
    ("--plugin file.py tune --slots 5", "no such file"),
]
BAD_INPUTS_WITH_A_RUN = [
    ("eval {run} --scenario paper", "which its network does not fit"),
    ("eval {run} --set scenario.devices=3", "which its network does not fit"),
    ("eval {run} --set algorithm.gamma=0.9", "algorithm.gamma"),
    ("eval {run} {other}", "--scenario"),
    ("eval {run} --out {run}", "it is a folder"),
    ("eval {broken}", "safetensors"),
    ("eval {fresh}", "no checkpoint yet"),
    ("plot figures {run} --out file", "'file'"),
    ("plot figures {fresh}", "episodes.csv"),
    ("plot trajectories {run} --out file/x", "'file"),
    ("plot trajectories {run} --episode-seed x", "--episode-seed"),
    ("plot trajectories {fresh}", "no checkpoint yet"),
    (f"{TINY} --algorithm mappo-paper", "--resume"),
]


def assert_refused(shell: Shell, command: str, says: str, place: Path) -> None:
    before = contents(place)
    err = shell.refused(command)
    _, *faults = err.splitlines()
    assert all(line.startswith("  ") for line in faults)
    assert not faults or err.splitlines()[0].endswith(f"{len(faults)} faults")
    assert says in err
    assert contents(place) == before


@pytest.mark.parametrize(("command", "says"), BAD_INPUTS)
def test_bad_input_is_one_line_and_nothing_happens(shell: Shell, workplace: Path, command: str, says: str) -> None:
    assert_refused(shell, command, says, workplace)


@pytest.mark.parametrize(("command", "says"), BAD_INPUTS_WITH_A_RUN)
def test_bad_input_about_runs_is_one_line_and_nothing_happens(
    shell: Shell, trained: Path, monkeypatch: pytest.MonkeyPatch, command: str, says: str
) -> None:
    assert_refused(shell, command.format(**runs(trained)), says, trained)


def test_a_device_or_folder_that_cannot_be_used_is_found_first(
    shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert_refused(shell, "train --device cuda", "--device cuda", workplace)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    for command in ("train", "eval --policy random --out x.csv"):
        assert_refused(shell, command, "Permission denied", workplace)


def test_the_process_reports_bad_input_as_main_does_and_other_errors_keep_their_traceback(
    monkeypatch: pytest.MonkeyPatch, workplace: Path
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("uavaou.reports.audit.audit", fail)
    with pytest.raises(ZeroDivisionError):
        main(["audit", "tiny"])
    done = run_process("train", "--scenario", "quikstart")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


def test_all_faults_of_a_scenario_are_lines_of_one_message(shell: Shell, workplace: Path) -> None:
    (workplace / "mine.yaml").write_text("base: paper\nslots: 1\nuavs: 2\naltitudes_m: [80]\ncds_m: []\nspeed: 3\n")
    err = shell.refused("fly mine.yaml")
    assert err == (
        "uavaou: mine.yaml: 4 faults\n"
        "  unknown field 'speed'; did you mean 'speed_m_s'?\n"
        "  slots = 1: must be greater than or equal to 2\n"
        "  altitudes_m: has 1 entries, needs one for each of the 2 uavs; [80, 90] would fit\n"
        "  cds_m: has 0 entries, needs one for each of the 2 uavs; [[0, 0], [0, 0]] would fit\n"
    )


def test_the_nearest_path_is_there_in_each_of_its_parts(tmp_path: Path) -> None:
    there = tmp_path / "studies" / "paper" / "seed-0"
    there.mkdir(parents=True)
    assert nearest_path(tmp_path / "studie" / "papr" / "seed-9") == f"; did you mean '{there}'?"
    for path in (there, there / "x", there.parent / "zzz", tmp_path / "zzz" / "paper"):
        assert nearest_path(path) == ""
