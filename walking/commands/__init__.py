"""Commands on robots of several limbs, and the report of a gait.

`soft-limb` finds `COMMANDS` by an entry point, and imports a module when its command runs.
"""

_GAITS = "walking.commands.gaits"
COMMANDS = {
    "gait": (_GAITS, "plan how a robot of several limbs walks"),
    "walk": (_GAITS, "walk by a gait: a robot, or an emulated one, from cold wires"),
}
