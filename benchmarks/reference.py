"""The tables of ``docs/reference``, each made from the code that it describes; :mod:`benchmarks.pages` writes them.

What something means is the comment beside it in the code, ``# meaning [source]``, or its docstring's first sentence.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any

import typer
from pydantic import BaseModel

from uavaou import Family, Scenario, World
from uavaou.algorithms.registry import load_config
from uavaou.draws import AltitudeDraw, CdsDraw, Draw, LengthDraw, OperationsDraw, WholeDraw
from uavaou.envs import rewards
from uavaou.envs.spaces import action_space, row_space, vector_space
from uavaou.evaluation import flights
from uavaou.field.route_files import FORMATS
from uavaou.mission_fields import Endurance, Failure, Links, RotaryWing, Silence, Wind
from uavaou.onboard import columns
from uavaou.planners import PLAN_AHEAD, PLANNERS, planner_knowledge
from uavaou.planners.plain import ITEMS
from uavaou.radio import THRESHOLDS, LineOfSight, with_radio
from uavaou.reports.markdown import table
from uavaou.runs import folder
from uavaou.runs.folder import RunFolder
from uavaou.scenario_fields import Range, ScenarioFields, WholeRange
from uavaou.units import UNITS, unit_of
from uavaou.world import knowledge
from uavaou.world.entities import make_views
from uavaou.world.views import COLLECTIONS
from uavaou.world.world import MissionMetrics
from uavaou.zones import Georeference, Zone
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path
from uavaou_cli.main import app

PAGES = tuple(
    f"docs/reference/{name}.md" for name in ("scenario", "environment", "commands", "algorithms", "planners", "files")
)
PARTS = (Range, WholeRange, Georeference, Zone, LineOfSight, Endurance, RotaryWing, Failure, Silence, Links, Wind)
DRAWS = (Draw, LengthDraw, WholeDraw, AltitudeDraw, CdsDraw, OperationsDraw)
POLICY_GRADIENT, VALUE_BASED = ("mappo", "mappo-paper", "mappo-family", "ippo"), ("vdn", "qmix", "iql")
_REMARK = re.compile(r'^ {4}(?:"?([\w-]+)"?[:,]? .*?)?# (.+)$')
_UNLIMITED = 1e9  # from which on a limit of a number only prevents overflows
_LOW = {"start": False, "ge": False, "minimum": False, "gt": True, "exclusiveMinimum": True}  # whether it is excluded
_HIGH = {"end": False, "le": False, "maximum": False, "lt": True, "exclusiveMaximum": True}


# -- what the code says --------------------------------------------------------------------------------


def remarks(source: str) -> dict[str, str]:
    """The comment beside each field or entry; one that stands alone is a heading, and has an empty text."""
    found = (_REMARK.match(line) for line in source.splitlines())
    return {each[1] or each[2]: each[2] if each[1] else "" for each in found if each}


def of_class(kind: type) -> dict[str, str]:
    """The remarks of a class, after those of the classes that it derives from."""
    own = [base for base in reversed(kind.__mro__) if base.__module__.startswith("uavaou.")]
    return {name: text for base in own for name, text in remarks(inspect.getsource(base)).items()}


def of_constant(module: Any, name: str) -> dict[str, str]:
    """The remarks of a constant of several lines."""
    found = re.search(rf"^{name}\b.*?^[\])}}]", inspect.getsource(module), re.DOTALL | re.MULTILINE)
    assert found is not None
    return remarks(found[0])


def named(head: Sequence[str], said: Mapping[str, str]) -> str:
    """A table of words and what each means."""
    return table(head, [(f"`{name}`", text) for name, text in said.items()])


def first_sentence(of: Any) -> str:
    """How a docstring begins, in Markdown."""
    paragraph = " ".join((inspect.getdoc(of) or "").partition("\n\n")[0].split())
    return re.split(r"(?<=\w{2}[.)])\s(?=[A-Z])", paragraph.replace("``", "`"))[0]


def in_words(schema: dict[str, Any]) -> str:
    """The values that a JSON schema lets pass."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return "a scenario" if name == "Scenario" else f"[{name}](#{name.lower()})"
    if "anyOf" in schema or "oneOf" in schema:
        several = schema.get("anyOf") or schema["oneOf"]
        each = (
            "list of such" if one.get("items") in several else in_words(one)
            for one in several
            if one.get("type") != "null"
        )
        return " or ".join(each)
    if "const" in schema or "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema.get("enum") or [schema["const"]])
    kind = schema["type"]
    if kind == "array":
        return "[x, y]" if "prefixItems" in schema else "list: " + in_words(schema["items"])
    return {"boolean": "true or false", "string": "text"}.get(kind) or _limits(schema)


def _limits(schema: dict[str, Any]) -> str:
    """The range of a number: JSON schema's words, and those that pydantic keeps behind a validator."""
    schema = {"start": -_UNLIMITED, "end": _UNLIMITED} | schema
    low, above = max((schema[key], strict) for key, strict in _LOW.items() if key in schema)
    high, included = min((schema[key], not strict) for key, strict in _HIGH.items() if key in schema)
    start = f"{'above' if above else 'from'} {low:,.10g}" if low > -_UNLIMITED else "any"
    end = f" to {'' if included else 'below '}{high:,.10g}" if high < _UNLIMITED else ""
    return f"{'whole, ' if schema['type'] == 'integer' else ''}{start}{end}".replace("any to", "up to")


def plain(value: Any) -> str:
    """A value as it is written in a file."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {plain(part)}' for name, part in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(plain, value))}]"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value).lower() if isinstance(value, bool) else f"{value:_}" if isinstance(value, int) else str(value)


# -- scenarios -----------------------------------------------------------------------------------------


def fields(kind: type[BaseModel], names: Iterable[str], usual: Mapping[str, Any] = MappingProxyType({})) -> str:
    """A table of fields of a configuration: unit, default, allowed values, meaning and source.

    Args:
        kind: the configuration.
        names: of its fields.
        usual: values where there is no default, shown in italics.
    """
    said, schema = of_class(kind), kind.model_json_schema()["properties"]
    rows: list[Sequence[str]] = []
    for name in names:
        default = schema[name].get("default", "required")
        if default in (None, "required") and name in usual:
            default = f"*{plain(usual[name])}*"
        meaning, _, source = said[name].removesuffix("]").partition(" [")
        unit = next(iter(UNITS[unit_of(name)][1])) if unit_of(name) else ""
        default = "–" if default is None else plain(default)
        rows.append((f"`{name}`", meaning, unit, default, in_words(schema[name]), source))
    shown = 6 if any(row[-1] for row in rows) else 5  # without the sources, where there are none
    head = ("field", "meaning", "unit", "default", "allowed", "source")
    return table(head[:shown], [row[:shown] for row in rows])


def scenario() -> str:
    """The fields of a scenario under the headings of the code."""
    paper = Scenario.load("paper").to_dict()
    groups: dict[str, list[str]] = {"The paper's model.": []}
    for name, text in of_class(ScenarioFields).items():
        if not text:
            groups[name] = []
        elif name in ScenarioFields.model_fields:
            list(groups.values())[-1].append(name)
    parts = (
        f"### {title.partition(';')[0].rstrip('.')}\n\n{fields(ScenarioFields, names, paper)}"
        for title, names in groups.items()
    )
    return "\n\n".join(parts)


def models(kinds: Sequence[type[BaseModel]]) -> str:
    """A heading, what it is and its fields, for each of some mappings."""
    parts = (f"### {kind.__name__}\n\n{first_sentence(kind)}\n\n{fields(kind, kind.model_fields)}" for kind in kinds)
    return "\n\n".join(parts)


def units() -> str:
    """What a quantity may be written in."""
    rows = [(f"`_{ending}`", kind, ", ".join(names)) for ending, (kind, names) in UNITS.items()]
    return table(("a field that ends with", "is", "and may be written in"), rows)


def radios() -> str:
    """The fields that each preset stands for."""
    names = [name for name in read_yaml_mapping(zoo_path("radios", "wifi")) if name not in THRESHOLDS]
    rows = []
    for name in zoo_names("radios"):
        given = with_radio({"radio": name})
        limits = (f"`{limit}` {plain(given[limit])}" for limit in THRESHOLDS if given.get(limit) is not None)
        rows.append((f"`{name}`", *(plain(given[each]) for each in names), *limits))
    return table(("radio", *(f"`{name}`" for name in names), "in range from"), rows)


# -- the environment -----------------------------------------------------------------------------------


def spaces() -> str:
    """The spaces of every kind of view on ``paper``."""
    rows = []
    for form, kinds in (("flat", ("location", "local", "shared")), ("entities", ("part", "local", "shared"))):
        for seen in kinds:
            layout = make_views(Scenario.load("paper"), seen, rows=form).layout
            sizes = vector_space(layout.local_size), row_space(layout), vector_space(layout.global_size)
            rows.append((f"`{form}`", f"`{seen}`", *(str(space.shape) for space in sizes)))
    return table(("rows", "observation", "observation space", "row of the `VecEnv`", "state"), rows)


def actions() -> str:
    """The spaces of actions on ``paper``."""
    layouts = {word: make_views(Scenario.load("paper"), collection=word).layout for word in COLLECTIONS}
    rows = [(f"`{word}`", f"`{action_space(layout)}`") for word, layout in layouts.items()]
    return table(("collection", "action space"), rows)


_TEXTS = read_yaml_mapping(Path(columns.__file__).with_suffix(".yaml"))


def described(texts: dict[str, Sequence[str]], sizes: dict[str, str] | None = None) -> list[tuple[str, ...]]:
    """A row for each column of an observation or a state: name, size, unit, meaning, and where a UAV has it from."""
    return [(f"`{name}`", *([sizes[name]] if sizes else []), *map(str, text)) for name, text in texts.items()]


def flat() -> str:
    """The columns of a flat observation, and the least observation that has each."""
    levels = {seen: make_views(Scenario.load("paper"), seen).layout.local for seen in ("shared", "local", "location")}
    sizes = {each.name: str(each.stop - each.start) for each in levels["shared"]}
    first = {each.name: seen for seen, parts in levels.items() for each in parts}
    rows = [(*row, first[row[0].strip("`")]) for row in described(_TEXTS["flat"], sizes)]
    return table(("column", "size on `paper`", "unit", "value", "from", "in, and in those that see more"), rows)


def tokens(texts: dict[str, dict[str, Sequence[str]]]) -> str:
    """The features of tokens."""
    rows = [(f"`{kind}`", *row) for kind, features in texts.items() for row in described(features)]
    return table(("token", "feature", "unit", "value", "from")[: len(rows[0])], rows)


def notation() -> str:
    """The words of these tables."""
    sources = [f"`{word}`: {text}" for word, text in _TEXTS["sources"].items()]
    return "\n".join(f"- {text}" for text in (*_TEXTS["notation"].strip().split("; "), *sources))


def metrics() -> str:
    """What infos say of a mission that is over."""
    said = {name: text.partition(") ")[2] for name, text in of_class(MissionMetrics).items()}
    return named(("metric", "value"), {name: said[name] for name in World("tiny").metrics().of(0)})


ENVIRONMENT: dict[str, Callable[[], str]] = {
    "spaces": spaces,
    "actions": actions,
    "rewards": lambda: named(("reward", "value"), of_constant(rewards, "REWARDS")),
    "metrics": metrics,
    "notation": notation,
    "flat": flat,
    "entities": lambda: tokens({kind: _TEXTS[kind] for kind in ("own", "teammates", "devices", "pulls")}),
    "without-radio": lambda: tokens(_TEXTS["without_radio"]),
    "alone": lambda: tokens(_TEXTS["alone"]),
    "state-flat": lambda: table(("column", "unit", "value"), described(_TEXTS["state"]["flat"])),
    "state-entities": lambda: tokens({kind: texts for kind, texts in _TEXTS["state"].items() if kind != "flat"}),
}


# -- algorithms and planners ---------------------------------------------------------------------------


def settings(names: Sequence[str]) -> str:
    """The settings of algorithms, with the published value of each."""
    published = {name: load_config(name) for name in names}
    kinds = [type(config) for config in published.values()]
    said = {name: text for kind in kinds for name, text in of_class(kind).items()}
    schema = {name: part for kind in kinds for name, part in kind.model_json_schema()["properties"].items()}
    rows = []
    for name in (name for name in schema if name != "name"):
        values = (plain(getattr(config, name)) if hasattr(config, name) else "–" for config in published.values())
        rows.append((f"`{name}`", said[name], *values, in_words(schema[name])))
    return table(("setting", "meaning", *(f"`{name}`" for name in names), "allowed"), rows)


def knows() -> str:
    """What each level reads."""
    return named(("knows", "what it reads in flight"), of_constant(knowledge, "Knowledge"))


def _items(found: Collection[str]) -> str:
    names = ", ".join(f"`{item}`" for item in found)
    return "all items" if set(ITEMS) <= set(found) else names or "–"


def planners() -> str:
    """What each planner is, knows, and reckons with of the items of missions."""
    rows = []
    for name, place in PLANNERS.items():
        kind = resolve_name(place)
        honoured = getattr(kind, "lives_with", ())
        plans = hasattr(kind, "lives_with")  # the others have nothing to reckon with
        ignored = [item for item in ITEMS if plans and item not in honoured]
        ahead = "yes" if name in PLAN_AHEAD else "–"
        known = planner_knowledge(name)
        rows.append((f"`{name}`", first_sentence(kind), known, ahead, _items(honoured), _items(ignored)))
    return table(("planner", "what it does", "knows", "plans ahead", "reckons with", "ignores"), rows)


# -- commands ------------------------------------------------------------------------------------------


def commands(group: Any = None, before: str = "") -> Iterator[tuple[str, Any]]:
    """Every command with its words."""
    root: Any = typer.main.get_command(app)
    for name, command in (group or root).commands.items():
        words = f"{before}{name}"
        yield from commands(command, f"{words} ") if hasattr(command, "commands") else [(words, command)]


def described_command(words: str, command: Any) -> str:
    """The help of a command as a section."""
    context = typer.Context(command, info_name=words)
    synopsis = " ".join(["uavaou", words, *command.collect_usage_pieces(context)])
    rows = []
    for parameter in command.params:
        names, text = parameter.get_help_record(context)
        meaning, _, default = text.partition("[default: ")
        written = names.partition(" <")[0].replace("|", "&#124;")  # not all readers take a bar in a cell of code
        rows.append((f"<code>{written}</code>", _safe(meaning.rstrip()), _safe(default.removesuffix("]"))))
    options = table(("argument or option", "meaning", "default"), rows)
    return f"### {words}\n\n```text\n{synopsis}\n```\n\n{_safe(command.help)}\n\n{options}"


def _safe(text: str) -> str:
    """Text in which ``<scenario>`` is no tag."""
    return re.sub(r"<([\w-]+)>", r"&lt;\1&gt;", text)


# -- files ---------------------------------------------------------------------------------------------


def columns_of(module: Any, *names: str) -> str:
    """The columns of a table in CSV."""
    said = (of_constant(module, constant) for constant in names)
    return named(("column", "content"), {name: text for each in said for name, text in each.items()})


def run_folder() -> str:
    """The files of a run folder."""
    said, run = of_class(RunFolder), RunFolder(Path())
    return named(("file", "content"), {str(getattr(run, name)): said[name] for name in said if hasattr(run, name)})


def routes() -> str:
    """The formats of routes."""
    rows = [(f"`{name}`", f"`NAME{ending}`", first_sentence(write)) for name, (ending, write) in FORMATS.items()]
    return table(("`--format`", "file", "content"), rows)


BLOCKS: dict[str, Callable[[], str]] = {
    "scenario": scenario,
    "scenario-parts": partial(models, PARTS),
    "family": lambda: fields(Family, Family.model_fields),
    "family-draws": partial(models, DRAWS),
    "units": units,
    "radios": radios,
    **ENVIRONMENT,
    "policy-gradient": partial(settings, POLICY_GRADIENT),
    "value-based": partial(settings, VALUE_BASED),
    "knows": knows,
    "planners": planners,
    **{f"command-{words.replace(' ', '-')}": partial(described_command, words, each) for words, each in commands()},
    "run-folder": run_folder,
    "episodes": partial(columns_of, folder, "EPISODE_COLUMNS"),
    "flights": partial(columns_of, flights, "KEY", "FLIGHTS"),
    "curves": partial(columns_of, flights, "KEY", "CURVES"),
    "routes": routes,
}
