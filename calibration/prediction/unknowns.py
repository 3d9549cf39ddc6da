"""The unknowns of a limb's wires and rubber, and their priors."""

import copy
import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from limb_systems import SegmentParameters, WireLaw
from limb_systems.wire_laws.wire_law import Prior

# Priors of the segment's unknowns; the laws' metadata have the priors of wires.
PRIORS: dict[str, Prior] = {
    "rest_angle": Prior(0.0, float(np.deg2rad(3.0)), 0.0),
    "rest_angle_e3": Prior(0.0, float(np.deg2rad(3.0)), 0.0),
    "stiffness": Prior(0.1246, 0.5, 0.0),
    "stiffness_ratio": Prior(1.0, 0.04, 0.0),  # a section cast to 1 or 2% of its width, squared
    "angle": Prior(0.0, float(np.deg2rad(2.0)), float(np.deg2rad(5.0))),
    "roll": Prior(0.0, float(np.deg2rad(6.0)), 0.0),
    "stiffening": Prior(0.08, 0.8, 0.0),
    "shift": Prior(float(np.deg2rad(1.5)), 0.5, 0.0),
    "rate": Prior(2.0, 0.5, 0.0),
}
LAG_FIELD = "a3"  # of a thermocouple
HEAT_SCALE_FIELD = "a2"  # of which the bend shows the product with the torque alone
READING_FIELDS = (LAG_FIELD, HEAT_SCALE_FIELD)  # which no bend tells
# °C, of what is below another field, see `WireLaw.below`
MIN_BELOW = 0.1
MAX_BELOW = 60.0
DEFAULT_SPREADS = (0.9, 0.3)  # spreads of a field without a prior, such as of a lab's own law
DEFAULT_TEMPERATURE_SPREADS = (12.0, 4.0)  # °C
MAX_RATE = 4.0  # 1/s, of rates: the open-loop simulation's steps follow no faster ones
MAX_ANGLE_CHANGE = np.deg2rad(60.0)
# Values, as the fit has them, with which a law or the rubber is as a simpler one without the field.
ABSENT_VALUES = {
    "silicone_warming": float(np.log(1e-5)),
    "knee": -20.0,
    "cooling_middle": float(np.log(MIN_BELOW)),
    **dict.fromkeys(["outer_warming", "direct_cooling", "convection", "silicone_share"], 0.0),
    **dict.fromkeys(["heating_drop", "latent_heat", "play_share", "stress_shift"], 0.0),
    "creep_share": 0.0,
    "stiffening": -9.0,
    "shift": -9.0,
}
# Fields that are another field of a simpler law.
FORMER_FIELDS = {"heating_middle": "middle"}
# Options of the rubber, with the unit of each number.
RUBBER_UNITS = {
    "stiffening": {"stiffening": "of k"},
    "rest_memory": {"rest_memory.shift": "rad", "rest_memory.rate": "1/rad"},
}


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One number that is fitted.

    - ``name``: name in the limb's parameters, such as "right.a1".
    - ``field``: field of the law, the segment or its memory.
    - ``wire``: index of the wire; None if it is the segment's.
    - ``unit``: unit of the value.
    - ``form``: "+" or "-" if the fit has the logarithm of ± the value, "" if the value.
    - ``center``: expected value, as the fit has it.
    - ``spread``, ``wire_spread``: see `Prior`.
    - ``low``, ``high``: bounds, as the fit has them.
    - ``below``: name of the unknown below which the value is, by what the fit has; "" if none.
    """

    name: str
    field: str
    wire: int | None
    unit: str
    form: str
    center: float
    spread: float
    wire_spread: float
    low: float
    high: float
    below: str = ""

    def value(self, fitted: np.ndarray) -> np.ndarray:
        """Return the value in its unit, or its distance below another, from the fitted number."""
        if not self.form:
            return fitted
        return np.exp(fitted) if self.form == "+" else -np.exp(fitted)


def values_of(unknowns: Sequence[Unknown], fitted: Iterable[Any]) -> list[Any]:
    """Return the values of unknowns (P) in their units, from the fitted numbers."""
    values = {u.name: u.value(x) for u, x in zip(unknowns, fitted, strict=True)}
    # The value of an unknown below another is so far the distance between them.
    distances = dict(values)
    for unknown in unknowns:
        if unknown.below:
            values[unknown.name] = distances[unknown.below] - distances[unknown.name]
    return [*values.values()]


def slopes_of(unknowns: Sequence[Unknown], fitted: Iterable[float]) -> np.ndarray:
    """Return the derivatives (P, P) of all values (rows) by all fitted numbers (columns).

    Args:
        unknowns: the unknowns (P).
        fitted: their numbers as the fit has them (P): the value, or a logarithm, see `Unknown`.
    """
    # Derive each value by its own number. If the number is a logarithm, the value is ± exp(x),
    # which is its own derivative.
    diagonal = np.ones(len(unknowns))
    rows: dict[str, int] = {}
    for row, (unknown, x) in enumerate(zip(unknowns, fitted, strict=True)):
        rows[unknown.name] = row
        if unknown.form:
            diagonal[row] = unknown.value(np.asarray(x))
    # A value below another is the other one less a distance, which its own number gives.
    slopes = np.diag(diagonal)
    for row, unknown in enumerate(unknowns):
        if unknown.below:
            slopes[row, row] *= -1
            slopes[row, rows[unknown.below]] = diagonal[rows[unknown.below]]
    return slopes


def laws_before_fit(law: type[WireLaw], segment: SegmentParameters) -> list[WireLaw]:
    """Return the law of each wire before the fit (W): as described, if it is of this class.

    Wires of other laws get the first law of this class. The fit keeps fields without a range, such
    as a word that chooses the equations of a lab's law.
    """
    laws = [wire.law for wire in segment.wires]
    first = next((described for described in laws if type(described) is law), law())
    return [copy.copy(described if type(described) is law else first) for described in laws]


def unknowns_of(
    law: type[WireLaw], segment: SegmentParameters, rubber: tuple[str, ...] = ()
) -> list[Unknown]:
    """Return the unknowns of a segment: of each wire by its law, then of the rubber.

    Args:
        law: class of the law that is fitted to all wires.
        segment: description of the segment; the laws of its wires give expected values.
        rubber: options that are fitted in addition to the angles at rest: any of
            "stiffening" and "rest_memory".
    """
    result = []
    fields = dataclasses.fields(law)  # type: ignore[arg-type]
    for field in (field for field in fields if "range" in field.metadata):
        # Bounds of the field, as the fit has it: a logarithm where the sign is fixed.
        above = law.below.get(field.name, "")
        low, high = (MIN_BELOW, MAX_BELOW) if above else field.metadata["range"]
        unit = field.metadata["unit"]
        form = ""
        if low > 0:
            form = "+"
        elif high < 0:
            form = "-"
        if unit == "1/s":
            low = max(low, -MAX_RATE)
            high = min(high, MAX_RATE)
        if form:
            low, high = sorted(np.log(np.abs([low, high])))
        # Prior of the field: the description's value, or the usual one of a limb like this.
        spreads = DEFAULT_TEMPERATURE_SPREADS if unit == "°C" else DEFAULT_SPREADS
        default = _distance_or_value(law(), field.name, above)
        prior = field.metadata["prior"] or Prior(default, *spreads)
        usual = prior.center
        if unit.startswith("N·m"):  # which bends a limb of any stiffness as far as the nominal one
            nominal = SegmentParameters()
            share_of_k = segment.stiffness / nominal.stiffness
            usual *= share_of_k * (nominal.links + 1) / (segment.links + 1)
        for index, wire in enumerate(segment.wires):
            is_described = hasattr(wire.law, field.name)
            center = _distance_or_value(wire.law, field.name, above) if is_described else usual
            if form:
                center = np.log(max(abs(center), 1e-12))
            margin = 1e-6 * (high - low)
            center = float(np.clip(center, low + margin, high - margin))
            name = f"{wire.name}.{field.name}"
            below = f"{wire.name}.{above}" if above else ""
            of_prior = center, prior.spread, prior.wire_spread
            result.append(Unknown(name, field.name, index, unit, form, *of_prior, low, high, below))
    # Unknowns of the segment.
    for name, number, unit, form, center, low, high in _segment_unknowns(segment, rubber):
        kind = name.split(".")[-1]
        prior = center, PRIORS[kind].spread, PRIORS[kind].wire_spread
        result.append(Unknown(name, kind, number, unit, form, *prior, low, high))
    return result


def _segment_unknowns(
    segment: SegmentParameters, rubber: tuple[str, ...]
) -> Iterator[tuple[str, int | None, str, str, float, float, float]]:
    """Yield name, wire, unit, form, center and bounds of unknowns that are no field of a law."""
    # Angles; in space also angles of wires and springs, as gravity bends a limb that is mounted in
    # several ways by amounts that depend on them.
    angles: list[tuple[str, int | None, float]] = [("rest_angle", None, segment.rest_angle)]
    springs = {}
    if segment.axes > 1:
        angles.append(("rest_angle_e3", None, segment.rest_angle_e3))
        angles.append(("bend_sensor.roll", None, segment.bend_sensor.roll))
        for index, wire in enumerate(segment.wires):
            angles.append((f"{wire.name}.angle", index, wire.angle))
        springs = {"stiffness": "N·m/rad", "stiffness_ratio": "of k"}
    for name, wire_index, angle in angles:
        yield name, wire_index, "rad", "", angle, angle - MAX_ANGLE_CHANGE, angle + MAX_ANGLE_CHANGE
    for name, unit in springs.items():
        center = float(np.log(getattr(segment, name)))
        yield name, None, unit, "+", center, center - 3.0, center + 3.0
    # Rubber that stiffens or remembers, if the fit is to have it.
    for option, units in RUBBER_UNITS.items():
        for name, unit in units.items() if option in rubber else ():
            yield name, None, unit, "+", np.log(PRIORS[name.split(".")[-1]].center), -9.0, 3.0


def split_unknowns(
    unknowns: list[Unknown], heated: np.ndarray, read: np.ndarray
) -> tuple[list[Unknown], list[Unknown]]:
    """Return the unknowns that recordings can identify, and the unknowns that they cannot.

    They cannot identify all unknowns of a wire that was never heated, the lag of a wire that has no
    thermocouple, and, if no wire has one, the scale of heat.

    Args:
        heated: True for each wire that is heated in any recording (W,).
        read: True for each wire whose thermocouple is read in any recording (W,).
    """
    identified: list[Unknown] = []
    unidentified: list[Unknown] = []
    for unknown in unknowns:
        is_identified = unknown.wire is None or heated[unknown.wire]
        if unknown.field == LAG_FIELD:
            is_identified &= read[unknown.wire]
        elif unknown.field == HEAT_SCALE_FIELD:
            is_identified &= read.any()
        (identified if is_identified else unidentified).append(unknown)
    return identified, unidentified


def _distance_or_value(law: WireLaw, name: str, above: str) -> float:
    """Return a field of a law, or its distance below the field ``above`` unless that is empty."""
    return getattr(law, above) - getattr(law, name) if above else getattr(law, name)


def prior_factor(unknowns: list[Unknown]) -> np.ndarray:
    """Return F (P, P) that whitens the prior: elements of F (x - center) are independent, of σ 1.

    Unknowns of the same field share a deviation (`Unknown.spread`), and each has one of its own
    (`Unknown.wire_spread`).
    """
    fields = np.array([unknown.field for unknown in unknowns])
    spreads = np.array([unknown.spread for unknown in unknowns])
    wire_spreads = np.array([unknown.wire_spread for unknown in unknowns])
    shared = np.outer(spreads, spreads) * (fields[:, None] == fields)
    return np.linalg.inv(np.linalg.cholesky(shared + np.diag(wire_spreads**2)))
