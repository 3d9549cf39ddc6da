"""What the bend angle of a recording is, so that fits compare like with like."""

from limb_systems import BendSensor, ChordSensor, Recording


def bend_sensor_of(recording: Recording, segment: int = 0) -> BendSensor:
    """What the bend of a segment was read by, as the recording's parameters say.

    A recording of the model itself, which has its joint states, was read by no
    sensor: its bend angle is that of the chord.
    """
    if recording.joint_state is not None:
        return ChordSensor()
    return recording.parameters.segments[segment].bend_sensor
