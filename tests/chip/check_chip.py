"""Runs the sketch's core on an emulated Cortex-M4F and M3, bit for bit as on this computer.

    python -m tests.chip.check_chip  (or `make chip`)

Random episodes with faults, bad frames and clocks that wrap are recorded with the core on this
computer. The core on the chip gets the same answers from its board, and must make the same calls:
the same bytes to the host, the same duties to the last bit. Arduino compiles with GNU's dialect of
C, in which a compiler may contract a multiplication and an addition, so both dialects are run.
"""

import random
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

from ..hardware.c_firmware import COMPILER, SKETCH, Recorder, compile_core
from ..hardware.test_firmware_in_c import Episode

EPISODES, PASSES = 30, 400
PLAYER = Path(__file__).with_name("player.c")
CROSS, LIBRARY, EMULATOR = "arm-none-eabi-gcc", "rdimon.specs", "qemu-system-arm"
CHIPS = {
    "Cortex-M4F": ("mps2-an386", ["-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]),
    "Cortex-M3": ("mps2-an385", ["-mcpu=cortex-m3"]),
}
# Packs what the board answered, as `player.c` reads it; other calls have no answer.
ANSWERS = {
    "ticks": lambda now: struct.pack("<I", now & 0xFFFFFFFF),
    "receive": lambda data: struct.pack("<H", len(data)) + data,
    "read_thermocouple": lambda word: word[::-1],
    "read_bend": lambda data: bytes([len(data)]) + data,
}


def record(core, rng: random.Random) -> tuple[bytes, bool]:
    """Return the answers of an episode's board, packed, and whether it heated."""
    recorders = []

    def program(board):
        recorders.append(Recorder(board))
        return core(recorders[0])

    episode, heated = Episode(rng, program), False
    for _ in range(PASSES):
        episode.pass_once()
        heated |= any(episode.duty)
    facts = recorders[0].facts
    start = struct.pack("<HBBH", PASSES, facts["reset_cause"], facts["remembered"], facts["random"])
    answers = (ANSWERS[name](result) for name, _, result in recorders[0].calls if name in ANSWERS)
    return start + b"".join(answers), heated


def build(folder: Path, compiler: str, options: list[str]) -> Path:
    """Return the program that plays episodes, built in a folder."""
    program = folder / "player"
    strict = ["-O2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(
        [compiler, *strict, *options, f"-I{SKETCH}", SKETCH / "core.c", PLAYER, "-o", program],
        check=True,
    )
    return program


def calls_of(folder: Path, command: list) -> bytes:
    """Return what the core did to its board while a command played the folder's episodes."""
    calls = folder / "calls.bin"
    calls.unlink(missing_ok=True)
    subprocess.run(command, cwd=folder, check=True, stdin=subprocess.DEVNULL)
    return calls.read_bytes()


def missing_packages() -> list[str]:
    """Return Debian's packages of the tools that are not installed."""
    tools = ("gcc", COMPILER), ("gcc-arm-none-eabi", CROSS), ("qemu-system-arm", EMULATOR)
    missing = [package for package, tool in tools if not tool or not shutil.which(tool)]
    find = f"{CROSS} -print-file-name={LIBRARY}"  # answers the name alone if it has none
    if subprocess.getoutput(find) != LIBRARY and "gcc-arm-none-eabi" not in missing:
        return missing
    return [*missing, "libnewlib-arm-none-eabi"]


def main() -> int:
    missing = missing_packages()
    if missing:
        print(f"Tools are missing: apt install {' '.join(missing)}.", file=sys.stderr)
        return 2
    rng, different = random.Random(0), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        core = compile_core(folder)
        episodes = [record(core, rng) for _ in range(EPISODES)]
        (folder / "answers.bin").write_bytes(b"".join(answers for answers, _ in episodes))
        program = build(folder, COMPILER, ["-std=c11"])
        expected = calls_of(folder, [program])
        print(
            f"{EPISODES} episodes of {PASSES} passes, {sum(heats for _, heats in episodes)} with "
            f"heat: {len(expected)} bytes of calls on this computer"
        )
        for chip, (machine, options) in CHIPS.items():
            for dialect in ("c11", "gnu11"):
                newlib = [f"-std={dialect}", "-mthumb", f"--specs={LIBRARY}"]
                newlib.append("-Wl,--section-start=.vectors=0")
                program = build(folder, CROSS, [*options, *newlib])
                emulate = [EMULATOR, "-M", machine, "-nographic", "-monitor", "none", "-serial",
                           "none", "-semihosting", "-kernel", program]  # fmt: skip
                same = calls_of(folder, emulate) == expected
                different += not same
                print(f"{chip}, -std={dialect}: {'the same calls' if same else 'OTHER CALLS'}")
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
