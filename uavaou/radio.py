"""Radios: what a scenario says beside the paper's channel, and the presets of ``radio: NAME``."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from uavaou.errors import nearest, unknown
from uavaou.fields import NonNegative, Number, Strict
from uavaou.zoo import read_yaml_mapping, zoo_names, zoo_path

PathLossExponent = Annotated[Number, Field(ge=1, le=10)]
ExcessLoss = Annotated[NonNegative, Field(le=300)]  # dB

# Of each of these a scenario has one.
GAINS = ("carrier_frequency_hz", "reference_gain_db")
THRESHOLDS = ("rate_min_bit_s", "snr_min_db", "sensitivity_dbm")
# Fields that the paper's channel lacks, with the values that give it. Those values stand in no file.
PAPER_CHANNEL: dict[str, Any] = {
    "path_loss_exponent": 2.0,
    "excess_loss_db": 0.0,
    "line_of_sight": None,
    "antenna_gain_db": 0.0,
    "snr_min_db": None,
    "sensitivity_dbm": None,
}


class LineOfSight(Strict):
    """Losses with and without a line of sight, and how probable one is at an elevation theta in degrees.

    P(LoS) = 1 / (1 + a exp(-b (theta - a))) (Al-Hourani, Kandeepan and Lardner, "Optimal LAP Altitude for Maximum
    Coverage", 2014).
    """

    a: Annotated[Number, Field(gt=0, le=100)]  # of the buildings, in degrees
    b: Annotated[Number, Field(gt=0, le=100)]  # of the buildings, in 1 / degree
    loss_los_db: ExcessLoss  # beyond free space, with a line of sight
    loss_nlos_db: ExcessLoss  # beyond free space, without one

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.loss_los_db > self.loss_nlos_db:
            raise ValueError(f"loss_los_db ({self.loss_los_db:g}) must not exceed loss_nlos_db ({self.loss_nlos_db:g})")
        return self


# Al-Hourani, Kandeepan and Lardner 2014: a and b from ITU-R P.1410's statistics of buildings, losses at 2 GHz.
ENVIRONMENTS = {
    "suburban": LineOfSight(a=4.88, b=0.43, loss_los_db=0.1, loss_nlos_db=21),
    "urban": LineOfSight(a=9.61, b=0.16, loss_los_db=1, loss_nlos_db=20),
    "dense-urban": LineOfSight(a=12.08, b=0.11, loss_los_db=1.6, loss_nlos_db=23),
}


def _environment(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    names = ("none", *ENVIRONMENTS)
    if value not in names:
        raise ValueError(f"must be {', '.join(names)} or {{a, b, loss_los_db, loss_nlos_db}}{nearest(value, names)}")
    return ENVIRONMENTS.get(value)


Environment = Annotated[LineOfSight | None, BeforeValidator(_environment)]


def with_radio(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario with ``radio`` replaced by the fields of the preset of that name.

    What is given beside it stays. What neither states is that of the paper's channel.

    Raises:
        InputError: no preset has the name.
    """
    given = dict(fields)
    if (name := given.pop("radio", None)) is None:
        return given
    preset = PAPER_CHANNEL | _preset(name)
    drop_superseded(preset, given)
    return preset | given


def _preset(name: Any) -> dict[str, Any]:
    names = zoo_names("radios")
    if name not in names:
        raise unknown("radio", str(name)[:40], names)
    fields = read_yaml_mapping(zoo_path("radios", name))
    base = fields.pop("base", None)
    return fields if base is None else _preset(base) | fields


def drop_superseded(fields: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Remove the inherited form of a quantity if ``changes`` give another form of it."""
    for forms in (GAINS, THRESHOLDS):
        if any(changes.get(form) is not None for form in forms):
            for form in forms:
                if changes.get(form) is None:
                    fields.pop(form, None)
