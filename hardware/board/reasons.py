"""The reasons for which a board is off, in words."""

from hardware.firmware import guard

REASONS = {
    guard.NO_REASON: "all is well",
    guard.NO_COMMAND: "no valid command came for 250 ms",
    guard.OUT_OF_RANGE: "a command was out of range",
    guard.BY_HOST: "the host switched it off",
    guard.POWER_UP: "it was just switched on",
    guard.WAS_RESET: "it was reset",
    guard.LATE_COMMANDS: "commands come more than 250 ms late",
    guard.BAD_BOUNDS: (
        "the limb's heat_bounds did not all arrive, are out of the board's range, or so wide that "
        "heat need not show; narrow them, or lower total_duty"
    ),
    guard.DISAGREEING: (
        "thermocouples and amplifiers disagree, or are below 10 °C; let the wires cool, then check "
        "them"
    ),
    guard.OVER_TEMPERATURE: "a wire is too hot",
    guard.THERMOCOUPLE_OPEN: "a thermocouple is open",
    guard.THERMOCOUPLE_TO_GROUND: "a thermocouple is shorted to ground",
    guard.THERMOCOUPLE_TO_SUPPLY: "a thermocouple is shorted to supply",
    guard.TEMPERATURE_JUMP: "a measured temperature jumped as no wire's can",
    guard.NOT_WARMING: "a wire is heated, but its thermocouple does not show it: it is off the "
    "wire or badly bonded, or the limb heats less than its heat_bounds say; let it cool, run "
    "arm-check, and mend what that finds, or collect and calibrate anew",
    guard.BEND_SILENT: "the bend sensor does not answer",
    guard.BEND_STUCK: "the bend sensor is stuck",
    guard.TOO_WARM: "a wire is warmer than its duty can make it: its MOSFET conducts, "
    "thermocouples are swapped, or the limb heats more than its heat_bounds say; let it cool, run "
    "arm-check, and mend what that finds, or collect and calibrate anew",
    guard.BELOW_ROOM: "a thermocouple reads less than the room's temperature",
    guard.AMPLIFIER: "an amplifier sends bits that it should not",
    guard.RESTARTED: "it restarted by itself",
    guard.CLOCK_STANDS: "its clock stands still",
}
