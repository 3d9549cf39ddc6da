"""What is unknown of a limb's wires and rubber, and what is known of it beforehand."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from limb_systems import SegmentParameters, WireLaw
from limb_systems.wire_laws.wire_law import Prior

# Unknowns of the segment; those of wires have theirs in the metadata of the laws.
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
LAG = "a3"  # of a thermocouple
HEAT_SCALE = "a2"  # of which the bend shows the product with the torque alone
OF_READINGS = (LAG, HEAT_SCALE)  # which no bend tells
LEAST_BELOW, MOST_BELOW = 0.1, 60.0  # °C, of what is below another field, see `WireLaw.below`
OTHER = (0.9, 0.3)  # spreads of a field without a prior, such as of a law of one's own
OTHER_TEMPERATURE = (12.0, 4.0)  # °C
FASTEST = 4.0  # 1/s, of rates: the open-loop simulation's steps follow no faster ones
REST_BOUND = np.deg2rad(60.0)
# Values, as the fit has them, with which a law or the rubber is as a simpler one without the field.
ABSENT = {
    "silicone_warming": float(np.log(1e-5)),
    "knee": -20.0,
    "cooling_middle": float(np.log(LEAST_BELOW)),
    **dict.fromkeys(["outer_warming", "direct_cooling", "convection", "silicone_share"], 0.0),
    **dict.fromkeys(["heating_drop", "latent_heat", "play_share", "stress_shift"], 0.0),
    "creep_share": 0.0,
    "stiffening": -9.0,
    "shift": -9.0,
}
# Fields that are another field of a simpler law.
FORMER = {"heating_middle": "middle"}
# Options of the rubber, with the unit of each number.
RUBBER = {
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
    - ``spread``, ``alike``: see `Prior`.
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
    alike: float
    low: float
    high: float
    below: str = ""

    def value(self, fitted: np.ndarray) -> np.ndarray:
        """Value in its unit, or how far it is below another, from that of the fit."""
        if not self.form:
            return fitted
        return np.exp(fitted) if self.form == "+" else -np.exp(fitted)


def values_of(unknowns: Sequence[Unknown], fitted: Iterable[Any]) -> list[Any]:
    """Values of unknowns (P) in their units, from those of the fit, each of any shape."""
    values = {u.name: u.value(x) for u, x in zip(unknowns, fitted, strict=True)}
    return [values[u.below] - values[u.name] if u.below else values[u.name] for u in unknowns]


def slopes_of(unknowns: Sequence[Unknown], fitted: Iterable[float]) -> np.ndarray:
    """Derivatives of the values by those of the fit (P, P)."""
    own = [u.value(np.asarray(x)) if u.form else 1.0 for u, x in zip(unknowns, fitted, strict=True)]
    slopes = np.diag(np.array(own, float))
    rows = {u.name: row for row, u in enumerate(unknowns)}
    for row, unknown in enumerate(unknowns):
        if unknown.below:
            slopes[row, row] *= -1
            slopes[row, rows[unknown.below]] = own[rows[unknown.below]]
    return slopes


def unknowns_of(
    law: type[WireLaw], segment: SegmentParameters, rubber: tuple[str, ...] = ()
) -> list[Unknown]:
    """All that is unknown of a segment whose wires follow a law: of each wire, then of the rest.

    Args:
        segment: description of the segment, whose wires' laws say what to expect.
        rubber: what is fitted of it besides the angles at rest: any of
            "stiffening" and "rest_memory".
    """
    result = []
    for field in dataclasses.fields(law):  # type: ignore[arg-type]
        above = law.below.get(field.name, "")
        low, high = (LEAST_BELOW, MOST_BELOW) if above else field.metadata["range"]
        unit = field.metadata["unit"]
        form = "+" if low > 0 else "-" if high < 0 else ""
        if unit == "1/s":
            low, high = max(low, -FASTEST), min(high, FASTEST)
        if form:
            low, high = sorted(np.log(np.abs([low, high])))
        for index, wire in enumerate(segment.wires):
            default = _described(law(), field.name, above) or 0.0
            described = _described(wire.law, field.name, above)
            center, spread, alike = _expected(segment, described, field, default)
            center = np.log(max(abs(center), 1e-12)) if form else center
            margin = 1e-6 * (high - low)
            center = float(np.clip(center, low + margin, high - margin))
            name, below = f"{wire.name}.{field.name}", f"{wire.name}.{above}" if above else ""
            numbers = center, spread, alike, low, high
            result.append(Unknown(name, field.name, index, unit, form, *numbers, below))
    for name, of_wire, unit, form, center, low, high in _of_segment(segment, rubber):
        what = name.split(".")[-1]
        _, spread, alike, _ = PRIORS[what]
        result.append(Unknown(name, what, of_wire, unit, form, center, spread, alike, low, high))
    return result


def _of_segment(
    segment: SegmentParameters, rubber: tuple[str, ...]
) -> Iterator[tuple[str, int | None, str, str, float, float, float]]:
    """Name, wire, unit, form, center and bounds of the unknowns that are of no law."""
    angles: list[tuple[str, int | None, float]] = [("rest_angle", None, segment.rest_angle)]
    springs = {}
    if segment.axes > 1:  # mountings under gravity then tell them
        angles.append(("rest_angle_e3", None, segment.rest_angle_e3))
        angles.append(("bend_sensor.roll", None, segment.bend_sensor.roll))
        angles += [(f"{wire.name}.angle", i, wire.angle) for i, wire in enumerate(segment.wires)]
        springs = {"stiffness": "N·m/rad", "stiffness_ratio": "of k"}
    for name, wire, angle in angles:
        yield name, wire, "rad", "", angle, angle - REST_BOUND, angle + REST_BOUND
    for name, unit in springs.items():
        center = float(np.log(getattr(segment, name)))
        yield name, None, unit, "+", center, center - 3.0, center + 3.0
    for option, units in RUBBER.items():
        for name, unit in units.items() if option in rubber else ():
            yield name, None, unit, "+", np.log(PRIORS[name.split(".")[-1]].center), -9.0, 3.0


def split_unknowns(
    unknowns: list[Unknown], heated: np.ndarray, read: np.ndarray
) -> tuple[list[Unknown], list[Unknown]]:
    """Unknowns that recordings tell something of, and unknowns that they do not.

    The latter are all unknowns of a wire that was never heated, the lag of a wire that has no
    thermocouple, and, if no wire has one, the scale of heat.

    Args:
        heated, read: whether each wire is (W,).
    """
    told: list[Unknown] = []
    untold: list[Unknown] = []
    for u in unknowns:
        tells = u.wire is None or heated[u.wire]
        if u.field == LAG:
            tells &= read[u.wire]
        elif u.field == HEAT_SCALE:
            tells &= read.any()
        (told if tells else untold).append(u)
    return told, untold


def _described(law: WireLaw, name: str, above: str) -> float | None:
    """A field of a law, or how far it is below another; None if the law does not have it."""
    if not hasattr(law, name):
        return None
    return getattr(law, above) - getattr(law, name) if above else getattr(law, name)


def _expected(
    segment: SegmentParameters, described: float | None, field: dataclasses.Field, default: float
) -> tuple[float, float, float]:
    """Center, spread and alikeness of a field of a law, see `Prior`."""
    unit, prior = field.metadata["unit"], field.metadata.get("prior")
    value, spread, alike, *_ = prior or (default, *(OTHER_TEMPERATURE if unit == "°C" else OTHER))
    if described is not None:
        value = described
    elif unit.startswith("N·m"):  # which bends a limb of any stiffness as far as the nominal one
        nominal = SegmentParameters()
        value *= segment.stiffness / nominal.stiffness * (nominal.links + 1) / (segment.links + 1)
    return value, spread, alike


def prior_factor(unknowns: list[Unknown]) -> np.ndarray:
    """F (P, P) with which F (x - center) has independent elements of standard deviation one."""
    count = len(unknowns)
    covariance = np.zeros((count, count))
    for row, one in enumerate(unknowns):
        for column, other in enumerate(unknowns):
            if one.field == other.field:
                covariance[row, column] = one.spread * other.spread
                if row == column:
                    covariance[row, column] += one.alike**2
    return np.linalg.inv(np.linalg.cholesky(covariance))
