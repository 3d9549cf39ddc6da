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

# Classes of specimens by their physics. A module with other physics adds its own class here.
SPECIMENS: dict[str, type[Specimen]] = {Specimen.physics: Specimen}
# Accuracy of simulations in space and of stiff limbs. At 1e-2 the integrator's least step is too
# long for the stiffest modes: simulations diverged for one limb in four that twists, has many links
# or is let go, and for all robots that stand on their limbs.
SPACE_ACCURACY = 1e-3
# Rate √(k / (m l²)), 1/s, of a link of mass m and length l, above which a limb is stiff; the
# nominal limb has 250.
STIFF_RATE = 500.0
# A hand grips with 20 times the limb's stiffness, in which one simulation in fifty diverged for
# limbs a little stiffer than the nominal limb.
STIFF_RATE_WITH_HAND = 300.0  # 1/s
ACCURACY_WITH_HAND = 1e-4
SWING_TIME = 30.0  # s at the beginning of a pause, simulated with fine steps
MIN_REST_STEPS = 270  # number of coarse steps for the remainder of a pause


class EmulatedSystem(LimbSystem, Protocol):
    """An emulated limb, or emulated connected limbs, whose attribute ``robot`` describes these."""

    def without_cut_out(self, context: Context) -> None:
        """Disable the cut-out in a Context, for a board that switches off by itself."""


class LimbTwin(Diagram):
    """An emulated limb, with the ports of `Limb` and more physics than the model.

    It is an emulation, not a measurement of a robot. The seed draws a `Specimen`. Its wires are
    shape-memory alloy with hysteresis, heat the silicone around them and differ from each other
    (`ShapeMemoryWires`). Its rubber stiffens and relaxes (`EmulatedRubber`). Its sensors are
    sampled, noisy, drifting and not quite linear (`SampledSensors`). A wire that is measured too
    hot switches the heaters off (`CutOut`, between the duty and the wires)::

                ┌──────────────────┐    ┌─────────────┐
        duty ──▶│ ShapeMemoryWires ├───▶│ manipulator ├─┬─▶ sensor ──▶ bend_angle
                └─┬────────────▲───┘    └──▲──────────┘ │
                  │            │           └─ Rubber ◀──┤
                  │            └────────────────────────┘
                  └─▶ ThermocoupleLag ──▶ sensor ──▶ measured_temperature

    All this is the physics "lumped". A specimen with other physics builds itself, and has only the
    ports in common, see `Specimen.build`.

    For a limb of n joints, W wires and F bends in all, see `limb_systems.layout.Layout`:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (F), rad, as bend sensors read it: α/2 of the tip's
      tangent, or another angle by each segment's ``bend_sensor``
    - output 2 ``applied_duty``: D (W) in the steps of the PWM
    - output 3 ``measurement``: [V (W), φ (F)], as they are read
    - output 4 ``cut_out``: 1 once a wire was measured at the board's limit of 110 °C, where
      the heaters are switched off until the end of the simulation, else 0
    - outputs 5 and 6, only if the truth is asked for: ``wire_temperature`` (W), °C, and
      ``joint_state`` [θ, θ̇] (2n), rad and rad/s

    ``parameters`` describes the limb as a lab would before calibration: only geometry and mass are
    true. Their ``board`` is the limb's identity, which recordings, calibrated limbs and plans
    contain, and from which `of` makes the limb again. The limb keeps its state after a simulation:
    a wire that was hot is warm, and hysteresis has a memory. `after_rest` is the same limb, later.
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time = False
    # Of simulations; 1e-4 changes no reading by more than one step of its sensor.
    accuracy: float | None = 1e-2

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
            extra: effects in addition to the effects of every limb, see `Specimen`.
            physics: "lumped", or another key of `SPECIMENS`.
            specimen: the particular limb, in place of these four.
            hand: bend angle over time, or both of two axes, rad, to which a hand bends the
                limb until the end of the trajectory.
            bend_rate: rate at which the bend sensors are read, Hz.
            wire_period: period of `ShapeMemoryWires`, s.
            truth: whether outputs and recordings have states that no sensor of a robot measures.

        Raises:
            ParameterError: if a parameter is out of its range.
            LimbError: if there is no such physics, or it has no such limb, or if the hand moves
                another number of bends than the limb has, or holds a limb of several segments.
        """
        super().__init__()
        if specimen is None:
            specimen = specimen_class(physics)(LimbParameters.of(parameters), seed, extra)
        self.specimen = specimen
        self.parameters = copy.deepcopy(specimen.description)
        self.parameters.board = specimen.board
        self.source = f"emulated limb, {specimen.label}"
        layout = LimbModel.of(self.parameters).layout
        # Choose the accuracy by the stiffest mode.
        squared_rates = [
            segment.stiffness * segment.links**3 / (segment.mass * segment.length**2)
            for segment in self.parameters.segments
        ]
        stiffest_rate = np.sqrt(max(squared_rates))
        if not layout.is_planar or stiffest_rate > STIFF_RATE:
            self.accuracy = SPACE_ACCURACY
        if hand is not None and stiffest_rate > STIFF_RATE_WITH_HAND:
            self.accuracy = ACCURACY_WITH_HAND
        # A hand moves all bends of a limb of one segment.
        if hand is not None and hand.rows() != layout.num_bends:
            raise LimbError(
                f"The hand moves {hand.rows()} bend angles, but the limb has {layout.num_bends}; "
                "give a trajectory with a row for each."
            )
        if hand is not None and len(self.parameters.segments) > 1:
            raise LimbError("An emulated hand holds limbs of one segment; this limb has more.")
        # Build the physics of the specimen.
        builder = DiagramBuilder()
        options: dict[str, Any] = {"bend_rate": bend_rate, "wire_period": wire_period}
        options |= {"hand": hand, "truth": truth}
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
        """Return the emulated limb that parameters were calibrated on, unused.

        Args:
            parameters: their ``board`` identifies the limb, or has the number of an emulated board
                that does. If the board is not emulated, a limb of their kind is drawn.
            seed: seed of that draw.

        Raises:
            LimbError: if the identity is invalid, or the board's number does not
                identify the limb.
        """
        board = emulated_limb(parameters.board)
        if not board:
            return cls(parameters, seed=seed)
        if board.limb:
            return cls(specimen=connected("specimen").of(board).limb(board.limb))
        return cls(specimen=specimen_class(board.physics).of(board))

    def after_rest(
        self,
        pause: float = 0.0,
        *,
        gravity: Sequence[float] | None = None,
        payload: float | None = None,
        hand: trajectories.Trajectory | None = None,
        bend_rate: float = 20.0,
        truth: bool = False,
    ) -> "LimbTwin":
        """Return the same limb in its present state, or after a pause without heat.

        Args:
            pause: s, to cool down.
            gravity: m/s² along (E1, E2, E3), if it changes from now on.
            payload: kg at the tip, if it changes from now on.
            hand, bend_rate, truth: as for the constructor.
        """
        if gravity is not None:
            self.specimen.description.gravity = list(gravity)
        if payload is not None:
            self.specimen.description.payload = payload
        # Without heat only the first swing is fast, so coarse steps are enough after it.
        swing = min(pause, SWING_TIME)
        coarse = min(self.specimen.rest_period, max(LONGEST_STEP, (pause - swing) / MIN_REST_STEPS))
        for duration, period in ((swing, LONGEST_STEP), (pause - swing, coarse)):
            if duration > 0:
                limb = LimbTwin(specimen=self.specimen, bend_rate=1.0, wire_period=period)
                rest(limb, duration, period)
        return LimbTwin(specimen=self.specimen, hand=hand, bend_rate=bend_rate, truth=truth)

    def without_cut_out(self, context: Context) -> None:
        """Disable the cut-out in a Context, for a board that switches off by itself."""
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


def specimen_class(physics: str) -> type[Specimen]:
    """Return the class of specimens of a physics; LimbError if no loaded module defines it."""
    if physics not in SPECIMENS:
        raise LimbError(
            f"No emulated limb of the physics {physics!r} is known here, only "
            f"{', '.join(SPECIMENS)}; name the module that defines it: soft-limb --import MODULE."
        )
    return SPECIMENS[physics]
