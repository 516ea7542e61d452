"""What the columns of a policy's input mean; the texts are in ``columns.yaml``."""

from pathlib import Path
from typing import Any

from uavaou.world.views import MOVES, RowLayout
from uavaou.zoo import read_yaml_mapping

_WIDE = {"teammates": ["teammates"], "devices": ["devices"], "pulls": ["devices"]}  # axes between rows and features


def describe_inputs(layout: RowLayout, observation: str, pulled: bool) -> dict[str, Any]:
    """Describe the inputs of an exported policy: notation, sources, and the inputs by name.

    Of an input it gives the shape, and each column's size, unit, scaling and source.

    Args:
        layout: of the rows that the policy reads.
        observation: ``location``, ``part``, ``local`` or ``shared``.
        pulled: whether the policy reads the pulls of entities.
    """
    texts = read_yaml_mapping(Path(__file__).with_suffix(".yaml"))
    described = {"notation": texts["notation"].strip(), "from": texts["sources"]}
    if layout.rows == "flat":
        sizes = {columns.name: columns.stop - columns.start for columns in layout.local}
        return described | {"inputs": {"local": _described(["rows", layout.local_size], sizes, texts["flat"])}}
    inputs = {}
    for name in (columns.name for columns in layout.local if pulled or columns.name != "pulls"):
        if name == "allowed_moves":
            inputs[name] = _described(["rows", MOVES], {name: MOVES}, texts["flat"])
            continue
        features = dict(texts[name])
        if observation != "shared":
            features |= texts["without_radio"].get(name, {})
        if observation == "part":
            features |= texts["alone"].get(name, {})
        shape = ["rows", *_WIDE.get(name, []), len(features)]
        inputs[name] = _described(shape, dict.fromkeys(features, 1), features)
    return described | {"inputs": inputs}


def _described(shape: list[Any], sizes: dict[str, int], texts: dict[str, list[str]]) -> dict[str, Any]:
    keys = ("unit", "scaling", "from")
    columns = {name: {"size": size} | dict(zip(keys, texts[name], strict=True)) for name, size in sizes.items()}
    return {"shape": shape, "type": "float32", "columns": columns}
