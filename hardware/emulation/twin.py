"""The emulated limb, for scripts without a robot."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydrake import trajectories
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from hardware.emulation.emulated_wires import LONGEST_STEP
from hardware.emulation.lumped import add_physics
from hardware.emulation.specimen import Specimen, emulated_limb
from limb_systems import LimbError, LimbModel, LimbParameters, LimbSystem, make_manipulator
from limb_systems.connected_limbs import connected
from limb_systems.simulation import PERIOD, make_simulator

# Kinds of specimens by their physics. A module with other physics adds its own specimen here.
SPECIMENS: dict[str, type[Specimen]] = {Specimen.physics: Specimen}
# Accuracy of simulations in space and of stiff limbs: the least step at 1e-2 is too long for the
# stiffest modes of limbs that twist, have many links or are let go, in which one limb in four got
# lost, and those of a robot that stands on its limbs all.
SPACE_ACCURACY = 1e-3
STIFF = 500.0  # 1/s, rate √(k / (m l²)) of a link of mass m and length l; of the nominal limb 250
# The grip of a hand is 20 times as stiff: of limbs that are a little stiffer than the nominal one,
# one in fifty got lost in it.
STIFF_HELD, HELD_ACCURACY = 300.0, 1e-4  # 1/s as above
SWING_TIME, REST_STEPS = 30.0, 270  # of a pause: s with fine steps, and least number of coarse ones


class EmulatedSystem(LimbSystem, Protocol):
    """An emulated limb, or emulated connected limbs, whose attribute ``robot`` describes these."""

    def without_cut_out(self, context: Context) -> None:
        """Let the heaters on in a Context, however hot: for a board that sees to it itself."""


class LimbTwin(Diagram):
    """An emulated limb, with the ports of `Limb` and more physics than the model.

    It is an emulation, not a measurement of a robot. The seed draws a
    `Specimen`. Its wires are shape-memory alloy with hysteresis, heat the silicone
    around them and differ from each other (`ShapeMemoryWires`). Its rubber
    stiffens and relaxes (`EmulatedRubber`). Its sensors are sampled, noisy, drifting and
    not quite linear (`SampledSensors`). A wire that is measured too hot switches the
    heaters off (`CutOut`, on the way of the duty)::

                ┌──────────────────┐    ┌─────────────┐
        duty ──▶│ ShapeMemoryWires ├───▶│ manipulator ├─┬─▶ sensor ──▶ bend_angle
                └─┬────────────▲───┘    └──▲──────────┘ │
                  │            │           └─ Rubber ◀──┤
                  │            └────────────────────────┘
                  └─▶ ThermocoupleLag ──▶ sensor ──▶ measured_temperature

    All this is its physics "lumped". A specimen of other physics builds itself, and shares the
    ports alone, see `Specimen.build`.

    For a limb of n joints, W wires and F bends in all, see `limb_systems.layout.Layout`:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (F), rad, as bend sensors read it: α/2 of the tip's
      tangent, or whatever each segment's ``bend_sensor`` is made for
    - output 2 ``applied_duty``: D (W) in the steps of the PWM
    - output 3 ``measurement``: [V (W), φ (F)], as they are read
    - output 4 ``cut_out``: 1 once a wire was measured at the board's limit of 110 °C, where
      the heaters are switched off until the end of the simulation, else 0
    - outputs 5 and 6, only if the truth is asked for: ``wire_temperature`` (W), °C, and
      ``joint_state`` [θ, θ̇] (2n), rad and rad/s

    ``parameters`` describes the limb as a lab would before calibration: only
    geometry and mass are true. Their ``board`` is the limb's identity, which
    recordings, calibrated limbs and plans carry along, and from which `of` makes
    the limb again. The limb keeps its state after a simulation: a wire that was
    hot is warm, and hysteresis has a memory. `again` is the same limb, later.
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time = False
    accuracy: float | None = (
        1e-2  # of simulations; 1e-4 changes no reading by more than one step of its sensor
    )

    def __init__(
        self,
        parameters: LimbParameters | str | Path | None = None,
        *,
        seed: int = 0,
        extra: Sequence[str] = (),
        physics: str = "lumped",
        specimen: Specimen | None = None,
        hand: trajectories.Trajectory | None = None,
        bend_rate: float = 20.0,
        wire_period: float = PERIOD,
        truth: bool = False,
    ):
        """
        Args:
            parameters: description of the kind of limb, or its YAML file; the nominal limb
                if None. Geometry, mass, gravity and limits are used unchanged;
                the seed draws all other values around the given ones.
            seed: seed of the particular limb and its sensors' noise.
            extra: effects that it has beside those of every limb, see `Specimen`.
            physics: "lumped", or another of `SPECIMENS`.
            specimen: the particular limb, in place of these four.
            hand: bend angle over time, or both of two axes, rad, to which a hand bends the
                limb until the end of the trajectory.
            bend_rate: rate at which the bend sensors are read, Hz.
            wire_period: period of `ShapeMemoryWires`, s.
            truth: whether it shows, and recordings have, what no sensor of a robot could.

        Raises:
            ParameterError: if a parameter is out of its range.
            LimbError: if there is no such physics, or it has no such limb, or if the hand moves
                another number of bends than the limb has, or holds a limb of several segments.
        """
        super().__init__()
        if specimen is None:
            specimen = specimens_of(physics)(LimbParameters.of(parameters), seed, extra)
        self.specimen, self.parameters = specimen, copy.deepcopy(specimen.description)
        self.parameters.board = specimen.board
        layout = LimbModel.of(self.parameters).layout
        stiffest = max(
            np.sqrt(s.stiffness * s.links**3 / (s.mass * s.length**2))
            for s in self.parameters.segments
        )
        if not layout.is_planar or stiffest > STIFF:
            self.accuracy = SPACE_ACCURACY
        if hand is not None and stiffest > STIFF_HELD:
            self.accuracy = HELD_ACCURACY
        if hand is not None and hand.rows() != layout.num_bends:
            raise LimbError(
                f"The hand moves {hand.rows()} bend angles, but the limb has {layout.num_bends}; "
                "give a trajectory with a row for each."
            )
        if hand is not None and len(self.parameters.segments) > 1:
            raise LimbError("An emulated hand holds limbs of one segment; this limb has more.")
        self.source = f"emulated limb, {specimen.label}"
        builder = DiagramBuilder()
        options: dict[str, Any] = {
            "hand": hand,
            "bend_rate": bend_rate,
            "wire_period": wire_period,
            "truth": truth,
        }
        if specimen.build:
            specimen.build(builder, **options)
        else:
            plant = make_manipulator(specimen.mechanics())
            manipulator = builder.AddNamedSystem("manipulator", plant)
            angles = specimen.state.get("joints", specimen.rest_angles())[: layout.num_joints]
            manipulator.SetDefaultPositions(angles)
            force = manipulator.get_applied_generalized_force_input_port()
            state = manipulator.get_state_output_port()
            _, duty = add_physics(builder, specimen, state, force, **options)
            builder.ExportInput(duty, "duty")
        builder.BuildInto(self)

    @classmethod
    def of(cls, parameters: LimbParameters, seed: int = 0) -> "LimbTwin":
        """The emulated limb that parameters were calibrated on, unused.

        Args:
            parameters: their ``board`` identifies the limb, or has the number of
                an emulated board that does. If it is not an emulated one, a limb
                of their kind is drawn.
            seed: seed of that draw.

        Raises:
            LimbError: if the identity is invalid, or the board's number does not
                say which limb it is.
        """
        board = emulated_limb(parameters.board)
        if not board:
            return cls(parameters, seed=seed)
        if board.limb:
            return cls(specimen=connected("specimen").of(board).limb(board.limb))
        return cls(specimen=specimens_of(board.physics).of(board))

    def again(
        self,
        pause: float = 0.0,
        *,
        gravity: Sequence[float] | None = None,
        payload: float | None = None,
        hand: trajectories.Trajectory | None = None,
        bend_rate: float = 20.0,
        truth: bool = False,
    ) -> "LimbTwin":
        """The same limb in its present state, or after a pause without heat.

        Args:
            pause: s, to cool down.
            gravity: m/s² along (E1, E2, E3), if the limb is mounted differently
                from now on.
            payload: kg at the tip from now on, if it is another than before.
            hand, bend_rate, truth: as for the constructor.
        """
        if gravity is not None:
            self.specimen.description.gravity = list(gravity)
        if payload is not None:
            self.specimen.description.payload = payload
        # Without heat only the first swing is fast, so coarse steps are enough.
        swing = min(pause, SWING_TIME)
        coarse = min(self.specimen.rest_period, max(LONGEST_STEP, (pause - swing) / REST_STEPS))
        for duration, period in ((swing, LONGEST_STEP), (pause - swing, coarse)):
            if duration > 0:
                limb = LimbTwin(specimen=self.specimen, bend_rate=1.0, wire_period=period)
                rest(limb, duration, period)
        return LimbTwin(specimen=self.specimen, hand=hand, bend_rate=bend_rate, truth=truth)

    def without_cut_out(self, context: Context) -> None:
        """Lets the heaters on in a Context, however hot: for a board that sees to it itself."""
        cut_out = self.GetSubsystemByName("heater_cut_out")
        limit = cut_out.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
        limit.SetAtIndex(0, np.inf)


def rest(twin: Any, duration: float, longest_step: float | None = None) -> None:
    """Let a twin rest without heat for a duration, in steps of the simulator, both s."""
    simulator = make_simulator(twin, twin.accuracy)
    if longest_step:
        simulator.get_mutable_integrator().set_maximum_step_size(longest_step)
    duty = twin.GetInputPort("duty")
    duty.FixValue(simulator.get_mutable_context(), np.zeros(duty.size()))
    simulator.AdvanceTo(duration)


def specimens_of(physics: str) -> type[Specimen]:
    """Return the kind of specimens of a physics; LimbError if no loaded module defines it."""
    if physics not in SPECIMENS:
        raise LimbError(
            f"No emulated limb of the physics {physics!r} is known here, only "
            f"{', '.join(SPECIMENS)}; name the module that defines it: soft-limb --import MODULE."
        )
    return SPECIMENS[physics]
