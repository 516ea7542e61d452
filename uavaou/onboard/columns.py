"""What the columns of a policy's input mean: unit, scaling, and where a UAV in flight has the value from."""

from typing import Any

from uavaou.world.views import DEVICE, MOVES, OWN, PULL, TEAMMATE, RowLayout

NOTATION = (
    "t: the slot to decide, 1 to K; U, I: numbers of UAVs and devices; step: a grid step; s(n) = n / (n + 20), n in "
    "slots; r(v): max(distance of the device from UAV v - its coverage radius, 0), in steps; size: columns"
)
SOURCES = {
    "map": "told before take-off, in mission.json",
    "own": "this UAV measures or counts it",
    "radio": "in each slot, every UAV tells the others its position and the devices that it has collected",
}
_MAP, _OWN, _RADIO = SOURCES

# name: unit before scaling, scaling, where the value is from
_FLAT = {
    "position": ("m", "x / area_x, y / area_y", _OWN),
    "uav_id": ("1", "1 at the number of this UAV, else 0", _MAP),
    "to_cds": ("m", "way to the own CDS (x, y) / longer side of the area", _OWN),
    "allowed_moves": ("1", "1 where allowed: stay, up (+y), down, right (+x), left", _OWN),
    "slots_left": ("slots", "(K + 1 - t) / K", _OWN),
    "budget_left": ("steps", "min(budget_steps - steps flown, K) / K", _OWN),
    "to_device_x": ("m", "(device - UAV) / longer side of the area", _OWN),
    "to_device_y": ("m", "(device - UAV) / longer side of the area", _OWN),
    "update_period": ("slots", "k_i / longest_update_period_slots", _MAP),
    "in_range": ("1", "1 where the rate to this UAV reaches R_min in slot t", _OWN),
    "since_own_collection": ("slots", "s(min(t - slot of this UAV's last collection, or 0, K))", _OWN),
    "other_positions": ("m", "x / area_x, y / area_y of each other UAV, in the order of their numbers", _RADIO),
    "age_sum": ("slots", "sqrt(age sum before slot t) / 20", _RADIO),
}
_OWN_TOKEN = {
    "present": ("1", "1", _MAP),
    "home_x": ("steps", "(CDS - UAV) / 5", _OWN),
    "home_y": ("steps", "(CDS - UAV) / 5", _OWN),
    "slots_left": ("slots", "n / (n + 100), n = K + 1 - t", _OWN),
    "slots_to_spare": ("steps", "clip(min(K - t, budget_steps - steps flown) - steps to the CDS, 0, 40) / 20", _OWN),
    "altitude": ("m", "altitude / 100", _MAP),
    "devices": ("1", "ln(I / 25)", _MAP),
    "uavs": ("1", "ln(U / 3)", _MAP),
}
_TEAMMATE_TOKEN = {
    "present": ("1", "1; a token of padding is all zero", _MAP),
    "x": ("steps", "(other UAV - UAV) / 5", _RADIO),
    "y": ("steps", "(other UAV - UAV) / 5", _RADIO),
    "distance": ("steps", "length of (other UAV - UAV) / 5", _RADIO),
    "altitude": ("m", "(its altitude - own altitude) / 20", _MAP),
    "home_x": ("steps", "(its CDS - UAV) / 5", _OWN),
    "home_y": ("steps", "(its CDS - UAV) / 5", _OWN),
}
_DEVICE_TOKEN = {
    "present": ("1", "1; a token of padding is all zero", _MAP),
    "x": ("steps", "(device - UAV) / 5", _OWN),
    "y": ("steps", "(device - UAV) / 5", _OWN),
    "distance": ("steps", "length of (device - UAV) / 5", _OWN),
    "steps_to_coverage": ("steps", "r(this UAV) / 5", _OWN),
    "coverage_radius": ("steps", "coverage radius / 2", _MAP),
    "in_range": ("1", "1 where the rate to this UAV reaches R_min in slot t", _OWN),
    "update_period": ("slots", "k_i / 5", _MAP),
    "since_own_collection": ("slots", "s(min(t - slot of this UAV's last collection, or 0, K))", _OWN),
    "age": ("slots", "sqrt(age sum before slot t) / 20", _RADIO),
    "since_collection": ("slots", "s(min(t - slot of the last collection, or 0, K))", _RADIO),
    "steps_of_nearest_other": ("steps", "b / 5, b = least r of the others, at most 20", _RADIO),
    "lead_of_nearest_other": ("steps", "clip(r(this UAV) - b, -10, 10) / 5", _RADIO),
    "age_over_steps": ("slots, steps", "age / (1 + r(this UAV)), age as scaled above", _RADIO),
    "own_part": ("1", "1 where the device is in this UAV's part of the map", _MAP),
}  # fmt: skip
_STEPS_LEFT = "steps from where the move leads to the nearest cell within this UAV's collection radius, at most 500"
_PULL_TOKEN = {
    "age": ("slots", "age sum at the end of slot t, 0 where in_range", _RADIO),
    **dict.fromkeys(PULL[1:-1], ("steps", _STEPS_LEFT, _OWN)),
    "shared": ("1", "1: the age is the true one", _MAP),
}
# What takes the place of the radio link where the observation is local.
_WITHOUT_RADIO = {
    "x": ("1", "0: not known", _MAP),
    "y": ("1", "0: not known", _MAP),
    "distance": ("1", "0: not known", _MAP),
    "age": ("slots", "sqrt(age sum before slot t if this UAV alone collected) / 20", _OWN),
    "since_collection": ("slots", "as since_own_collection", _OWN),
    "steps_of_nearest_other": ("steps", "b / 5, b = least r of the others at their CDSs, at most 20", _MAP),
    "lead_of_nearest_other": ("steps", "clip(r(this UAV) - b, -10, 10) / 5", _OWN),
    "age_over_steps": ("slots, steps", "age / (1 + r(this UAV)), age as scaled above", _OWN),
}  # fmt: skip
_PULL_WITHOUT_RADIO = {
    "age": ("slots", "age sum at the end of slot t if this UAV alone collected, 0 where in_range", _OWN),
}
# What the UAV sees of its own part of the map, where the observation is that alone.
_ALONE = {
    "own": {
        "devices": ("1", "ln(max(devices in this UAV's part, 1) / 25)", _MAP),
        "uavs": ("1", "ln(1 / 3)", _MAP),
    },
    "teammates": dict.fromkeys(TEAMMATE, ("1", "0: not used", _MAP)),
    "devices": {
        "present": ("1", "1 in this UAV's part of the map; the token of another device is all zero", _MAP),
        "steps_of_nearest_other": ("steps", "4: as if far away", _MAP),
        "lead_of_nearest_other": ("steps", "clip(r(this UAV) - 20, -10, 10) / 5", _OWN),
    },
    "pulls": {},
}


def describe_inputs(layout: RowLayout, observation: str, pulled: bool) -> dict[str, Any]:
    """Describe the inputs of an exported policy: shape, and each column's size, unit, scaling and source.

    Args:
        layout: of the rows that the policy reads.
        observation: ``location``, ``part``, ``local`` or ``shared``.
        pulled: whether the policy reads the pulls of entities.
    """
    if layout.rows == "flat":
        sizes = {columns.name: columns.stop - columns.start for columns in layout.local}
        return {"local": _described(["rows", layout.local_size], sizes, _FLAT)}
    radio = observation == "shared"
    tokens = {
        "own": (OWN, _OWN_TOKEN), "teammates": (TEAMMATE, _TEAMMATE_TOKEN), "devices": (DEVICE, _DEVICE_TOKEN),
        "pulls": (PULL, _PULL_TOKEN),
    }  # fmt: skip
    inputs = {}
    for columns in layout.local:
        if columns.name == "pulls" and not pulled:
            continue
        if columns.name == "allowed_moves":
            inputs[columns.name] = _described(["rows", MOVES], {columns.name: MOVES}, _FLAT)
            continue
        names, texts = tokens[columns.name]
        if not radio:
            without = _PULL_WITHOUT_RADIO if columns.name == "pulls" else _WITHOUT_RADIO
            texts = {name: without[name] if text[2] == _RADIO else text for name, text in texts.items()}
        if observation == "part":
            texts = texts | _ALONE[columns.name]
        axis = {"own": [], "pulls": ["devices"]}.get(columns.name, [columns.name])
        shape = ["rows", *axis, len(names)]
        inputs[columns.name] = _described(shape, dict.fromkeys(names, 1), texts)
    return inputs


def _described(shape: list[Any], sizes: dict[str, int], texts: dict[str, tuple[str, str, str]]) -> dict[str, Any]:
    keys = ("unit", "scaling", "from")
    columns = {name: {"size": size} | dict(zip(keys, texts[name], strict=True)) for name, size in sizes.items()}
    return {"shape": shape, "type": "float32", "columns": columns}
