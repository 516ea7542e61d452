"""``uavaou route``: files for each UAV, what they cost, and refusals; a plan's file where a planner's name stands."""

import json
from pathlib import Path

import pytest

from tests.cli.commands import Shell, contents
from uavaou_cli.tables import WIDTH

PLACE = "georeference: {latitude: 46.1012, longitude: 7.2210}"


@pytest.fixture
def field(workplace: Path) -> Path:
    (workplace / "field.yaml").write_text(f"base: quickstart\n{PLACE}\nuav_names: [north/1, süd]\n", encoding="utf-8")
    return workplace


def test_a_policy_becomes_files_and_its_routes_are_compared_with_it(shell: Shell, field: Path) -> None:
    every = " ".join(f"--format {form}" for form in ("plan", "wpl", "kml", "geojson", "csv", "csv"))
    out = shell.done(f"route field.yaml --policy best-first {every} --episodes 20 --quiet --out there")
    assert all(len(line) <= WIDTH for line in out.splitlines() if not line.startswith("there/"))
    endings = ("csv", "geojson", "kml", "plan", "waypoints")
    files = [f"north%2F1.{end}" for end in endings] + ["plan.json"] + [f"süd.{end}" for end in endings]
    assert list(contents(Path("there"))) == [f"there/{name}" for name in files]
    assert sorted(line for line in out.splitlines() if line.startswith("there/")) == [f"there/{name}" for name in files]
    assert "field: 20 missions, seeds 10000 to 10019" in out
    assert "its routes, open loop" in out
    assert "Open loop, without what the policy hears, the mean AoU is 0." in out
    rule = shell.done("route field.yaml --policy local-greedy-parts --format csv --episodes 20 --quiet --out rule")
    assert "anneal plans routes for open loop: compare --policy anneal." in rule
    again = shell.done("route --policy there/plan.json --format csv --episodes 20 --quiet --out again")
    assert "The policy flies these routes in every mission." in again
    assert Path("again/süd.csv").read_bytes() == Path("there/süd.csv").read_bytes()
    open_loop = next(line for line in out.splitlines() if line.startswith("its routes")).split()[4:]
    assert next(line for line in again.splitlines() if line.startswith("there/plan.json")).split()[1:] == open_loop
    played = shell.done("eval --policy there/plan.json --episodes 20 --quiet")
    assert played.startswith("field: 20 missions")
    assert shell.done("eval any-map --policy there/plan.json --episodes 1 --quiet").startswith("field: 1 mission")
    assert open_loop[0] in played
    page = shell.done("replay there/plan.json best-first --quiet --out page.html").splitlines()[-1]
    assert "best-first, open loop" in Path(page).read_text(encoding="utf-8")


def test_what_fly_serves_is_exported(shell: Shell, field: Path) -> None:
    for command, folder in (("route field.yaml", "route/auto"), ("fly field.yaml --route plan", "fly/auto/route")):
        out = shell.done(f"{command} --seconds 1 --quiet")
        assert "Served: " in out
        (place,) = Path("results").glob(f"field*/{folder}")
        assert {path.name for path in place.iterdir()} == {"north%2F1.plan", "süd.plan", "plan.json"}
        assert json.loads((place / "plan.json").read_text())["planner"].endswith(", open loop")


def test_saved_rules_and_plans_are_flown(shell: Shell, field: Path) -> None:
    for planner in ("tour", "local-greedy-tuned"):
        shell.done(f"plan field.yaml --planner {planner} --time-limit 2 --episodes 1 --out {planner} --quiet")
        mean = json.loads(Path(planner, "plan.json").read_text())["mean_aou_s"]
        assert mean > 0
        files = shell.done(f"route field.yaml --policy {planner}/plan.json --quiet --episodes 4 --out {planner}/route")
        assert f"{planner}/route/süd.plan" in files


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("route quickstart", "add to the scenario the place of x = y = 0, such as georeference: {latitude: 46.1012, "),
        ("route quickstart --format kml", "--format kml: quickstart does not say where it lies on the earth"),
        ("route quickstart --format cvs", "unknown --format 'cvs'; did you mean 'csv'?"),
        ("route field.yaml --policy gredy", "unknown policy 'gredy'; did you mean 'greedy'?"),
        ("route field.yaml --policy no.json", "no.json: cannot be read: No such file"),
        ("route --policy no.json", "no.json: cannot be read: No such file"),
        ("route", "missing argument 'SCENARIO'"),
        (
            "route field.yaml --set scenario.layout=resample",
            "draws a new one each mission; set layout: fixed",
        ),
        ("route field.yaml --set 'scenario.energy={endurance_s: 1500}'", "a route file is of one sortie"),
        ("route field.yaml --policy greedy --knows local", "--knows local does not allow"),
        ("fly quickstart --route plan", "add to the scenario the place of x = y = 0"),
        ("route field.yaml --out file", "'file' is not a folder"),
        ("eval file.json --quiet", "file.json' is no run folder; for the plan of that file, write --policy file.json"),
        ("eval --policy file.json", "is not a plan"),
        ("replay file.json", "file.json: "),
    ],
)
def test_refusals(shell: Shell, field: Path, command: str, said: str) -> None:
    Path("file.json").write_text("{}")
    before = contents(field)
    err = shell.refused(command)
    assert said in err
    assert err.count("\n") == 1
    assert contents(field) == before
