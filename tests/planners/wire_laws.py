"""Laws of one's own, and limbs with all that a law and its rubber may have."""

import dataclasses

import numpy as np

from limb_systems import (
    HystereticLaw,
    LimbModel,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    ThresholdLaw,
    WireLaw,
    WireParameters,
)
from limb_systems.files.schema import quantity


@dataclasses.dataclass
class QuadraticLaw(LinearLaw):
    beta_2: float = quantity(6.0e-6, "N·m/°C²", 0.0, 1.0)

    def torque(self, x, T0, theta):
        return self.beta * (x[0] - T0) + self.beta_2 * (x[0] - T0) ** 2


@dataclasses.dataclass
class SiliconeLaw(WireLaw):
    """Heat goes to silicone, S, and torque sets in at a threshold and fades with the angle."""

    states = {"T": 50.0, "S": 50.0}  # noqa: RUF012
    to_silicone: float = quantity(0.25, "1/s", 0.0, 10.0)
    from_wire: float = quantity(0.06, "1/s", 0.0, 10.0)
    to_room: float = quantity(0.05, "1/s", 0.0, 10.0)
    heating: float = quantity(45.0, "°C/s", 0.0, 1000.0)
    lag: float = quantity(-0.4, "1/s", -10.0, 0.0)
    slope: float = quantity(6.0e-4, "N·m/°C", 0.0, 1.0)
    softness: float = quantity(0.3, "1/rad", 0.0, 10.0)

    def rates(self, x, D, T0):
        T, S = x
        flow = T - S
        return [
            self.heating * D - self.to_silicone * flow,
            self.from_wire * flow - self.to_room * (S - T0),
        ]

    def torque(self, x, T0, theta):
        above = 8.0 * np.log(1.0 + np.exp((x[0] - 45.0) / 8.0))
        return self.slope * above * (1.0 - self.softness * theta)

    def reading_rate(self, V, x):
        return self.lag * (V - x[0])


@dataclasses.dataclass
class RadiatingLaw(LinearLaw):
    """Heat that is not linear: it radiates."""

    radiation: float = quantity(3.0e-4, "1/(s °C)", 0.0, 1.0)

    def rates(self, x, D, T0):
        above = x[0] - T0
        return [self.a1 * above - self.radiation * above**2 + self.a2 * D]


def limb_with(*laws: WireLaw) -> LimbParameters:
    limb = LimbParameters()
    for wire, law in zip(limb.wires, laws, strict=True):
        wire.law = law
    return limb


def mixed_limb() -> LimbParameters:
    """Laws of one and of two states side by side, three wires, one of them off both axes."""
    wires = [
        WireParameters("low", -0.003, law=SiliconeLaw()),
        WireParameters("high", 0.003, law=QuadraticLaw()),
        WireParameters("slanting", 0.003, 0.004, law=SiliconeLaw(slope=4.0e-4)),
    ]
    return LimbParameters(
        segments=[SegmentParameters(links=3, wires=wires), SegmentParameters(links=2)]
    )


def remembering_limb() -> LimbParameters:
    """Rubber that rests bent, stiffens and remembers, with laws of two and of three states."""
    wires = [
        WireParameters("left", -0.003, law=HystereticLaw()),
        WireParameters("right", 0.003, 0.002, law=ThresholdLaw()),
    ]
    first = SegmentParameters(
        links=3, wires=wires, rest_angle=0.1, stiffening=0.4, rest_memory=RestMemory()
    )
    second = SegmentParameters(links=2, rest_memory=RestMemory(0.05, 1.0))
    return LimbParameters(segments=[first, second])


def soft_limb() -> LimbParameters:
    """Its cold wires hardly pull, and so its memory hardly follows them at first."""
    limb = limb_with(ThresholdLaw(), ThresholdLaw())
    rubber = {"rest_angle": 0.05, "stiffening": 0.3, "rest_memory": RestMemory()}
    limb.segments[0] = dataclasses.replace(limb.segments[0], **rubber)
    return limb


LIMBS = {
    "quadratic": lambda: limb_with(QuadraticLaw(), QuadraticLaw(beta_2=2e-6)),
    "silicone": lambda: limb_with(SiliconeLaw(), SiliconeLaw(slope=5e-4)),
    "radiating": lambda: limb_with(RadiatingLaw(), LinearLaw()),
    "mixed": mixed_limb,
    "remembering": remembering_limb,
    "soft": soft_limb,
}


def random_state(limb: LimbParameters, generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Warm states (size, 2n + N + W) and duty (size, W)."""
    n, wires = limb.num_joints, LimbModel.of(limb).wires
    is_temperature = wires.heat_scales == 50.0
    low, high = np.where(is_temperature, [[30.0], [100.0]], [[0.0], [1.0]] * wires.heat_scales)
    return (
        np.hstack(
            [
                generator.uniform(-1, 1, (size, n)),
                generator.uniform(-5, 5, (size, n)),
                generator.uniform(low, high, (size, len(low))),
            ]
        ),
        generator.uniform(0, 1, (size, wires.num_wires)),
    )
