"""docs/firmware_in_c.md: its pieces of C are the protocol, its table of rules the checks."""

import random
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from hardware.firmware import guard, heat, protocol
from hardware.robot.board_check import RULES

PAGE = (Path(__file__).parents[2] / "docs" / "firmware_in_c.md").read_text(encoding="utf-8")
STRUCTS = {
    "arm": protocol.ARM,
    "command": protocol.COMMAND,
    "clear": protocol.CLEAR,
    "info": protocol.INFO,
    "sample": protocol.SAMPLE,
}

MAIN = r"""
#include <stdio.h>

static void show(const char *name, const uint8_t *data, int size)
{
    printf("%s ", name);
    for (int i = 0; i < size; i++)
        printf("%02x", data[i]);
    printf("\n");
}

int main(void)
{
    printf("sizes %d %d %d %d %d\n", (int)sizeof(struct arm), (int)sizeof(struct command),
           (int)sizeof(struct clear), (int)sizeof(struct info), (int)sizeof(struct sample));
    printf("crc %08X\n", (unsigned)crc32((const uint8_t *)"123456789", 9));
    uint8_t frame[64];
    struct info info = {3, 50, 440, "mine0001", 2, 5};
    show("info", frame, make_frame(frame, INFO, &info, sizeof info));
    struct sample sample = {0x7E7D, 0x03030303, 4711, 1, 16, 0x7D7E, {-3, 440}, -6400,
                            {10000, 3}, {126, 3}};
    show("sample", frame, make_frame(frame, SAMPLE, &sample, sizeof sample));
    struct heat heat = {0.042f, 0.095f, 17, 23, 0.5f};
    for (int i = 0; i < 2000; i++)
        heat_step(&heat, 0.2f, 10, 0.05f);
    printf("heat %f %f %f %f %f\n", heat.least, heat.least_reading, heat.most, heat.shortfall,
           allowed_duty(&heat, 60));
    heat_step(&heat, 1, 10, 0.05f);
    printf("hidden %f\n", heat.hidden);
    struct heat hiding = {0.2f, 0.5f, 4, 8, 0.1f};
    printf("shown %d %d %d\n", shown(&heat, 1), shown(&hiding, 1), shown(&hiding, 0.1f));
    struct guard guard = {1, 0, 0, 7, 7, 0, 1000, 1000};
    struct command first = {7, 1, 950, {0, 2500}}, late = {7, 2, 900, {9, 9}};
    take_command(&guard, &first, 1010);
    take_command(&guard, &late, 1150);
    tick(&guard, 1259);
    printf("guard %d %u %g", guard.armed, (unsigned)guard.acknowledged, guard.asked[1]);
    tick(&guard, 1260);
    printf(" %d %d %u %g\n", guard.armed, guard.reason, guard.challenge, guard.asked[1]);
    struct parser parser = {.lost = 1};
    int byte;
    while ((byte = getchar()) != EOF) {
        int size = take_byte(&parser, byte);
        if (size >= 0)
            show("frame", parser.body + 1, 1 + size);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """What a program of the page's C prints: its lines, and what it was fed."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        pytest.skip("there is no C compiler here")
    folder = tmp_path_factory.mktemp("c")
    pieces = re.findall(r"^```c\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    (folder / "board.c").write_text("\n".join(pieces) + MAIN, encoding="utf-8")
    options = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-missing-field-initializers"]
    command = [compiler, *options, "-o", "board", "board.c"]
    subprocess.run(command, cwd=folder, check=True)
    rng = random.Random(0)
    stream = b""
    for number in range(300):
        frame = protocol.encode(protocol.COMMAND, 7, number, rng.getrandbits(32), 3, 0x7E7D)
        frame += protocol.encode(protocol.ARM, *[rng.getrandbits(16) for _ in range(12)])
        frame += protocol.encode(rng.choice([protocol.HELLO, protocol.DISARM]))[1:]
        damaged = bytearray(frame)
        if number % 3 == 0:
            damaged[rng.randrange(len(damaged))] = rng.choice([0x7E, 0x7D, rng.getrandbits(8)])
        stream += rng.randbytes(rng.randrange(50)) * (number % 2) + bytes(damaged)
    done = subprocess.run([folder / "board"], input=stream, capture_output=True, check=True)
    return [line.split() for line in done.stdout.decode().splitlines()], stream


def line(printed, name):
    (words,) = (words[1:] for words in printed[0] if words[0] == name)
    return words


def test_structs_have_the_sizes_of_the_payloads(printed):
    sizes = [struct.calcsize(protocol._FORMATS[kind]) for kind in STRUCTS.values()]
    assert [int(size) for size in line(printed, "sizes")] == sizes
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \|$", PAGE, re.MULTILINE)
    assert [(name, int(size)) for name, size in rows] == list(zip(STRUCTS, sizes, strict=True))


def test_frames_are_the_same_bytes(printed):
    assert line(printed, "crc") == ["CBF43926"]
    info = protocol.encode(protocol.INFO, 3, 50, 440, b"mine0001", 2, 5)
    values = 0x7E7D, 0x03030303, 4711, 1, 16, 0x7D7E, -3, 440, -6400, 10000, 3, 126, 3
    assert bytes.fromhex(line(printed, "info")[0]) == info
    assert bytes.fromhex(line(printed, "sample")[0]) == protocol.encode(protocol.SAMPLE, *values)


def test_the_parser_takes_the_same_frames(printed):
    kinds = (protocol.HELLO, protocol.ARM, protocol.COMMAND, protocol.DISARM, protocol.CLEAR)
    expected = [
        (bytes([kind]) + struct.pack(protocol._FORMATS[kind], *values)).hex()
        for kind, values in protocol.Parser(kinds).feed(printed[1])
    ]
    assert 600 < len(expected) < 900
    assert [words[1] for words in printed[0] if words[0] == "frame"] == expected


def test_the_heat_is_the_same(printed):
    wire = heat.WireObserver(0.0)
    for _ in range(2000):
        wire.advance(0.2, 0.05, 10.0)
    allowed = wire.allowed_duty(60.0)
    expected = [wire.least, wire.least_reading, wire.most, wire.shortfall, allowed]
    assert [float(word) for word in line(printed, "heat")] == pytest.approx(expected, rel=1e-3)

    wire.advance(1.0, 0.05, 10.0)
    assert float(line(printed, "hidden")[0]) == pytest.approx(wire.hidden, rel=1e-3)
    hiding = (0.2, 0.5, 4.0, 8.0, 0.1)
    shown = heat.shown(heat.NOMINAL, 1.0), heat.shown(hiding, 1.0), heat.shown(hiding, 0.1)
    assert [bool(int(word)) for word in line(printed, "shown")] == list(shown)


def test_commands_and_their_time_are_the_same(printed):
    subject = guard.Guard(0, 7)
    subject.state, subject.session, subject._total = guard.ARMED, 7, 2.0
    subject._heard = subject._answered = 1000
    subject._allowed = [1.0, 1.0]
    subject.command(7, 1, 950, 0.0, 0.25, 1010)
    subject.command(7, 2, 900, 9e-4, 9e-4, 1150)
    subject.tick(1259)
    seen = [subject.state, subject.acknowledged, subject.duty[1]]
    subject.tick(1260)
    seen += [subject.state, subject.reason, subject.challenge, subject.duty[1]]
    assert [float(word) for word in line(printed, "guard")] == seen


def test_the_table_of_rules_is_the_list_of_checks():
    rows = re.findall(
        r"^\| (.+) \| \[[\w ]+\]\(protocol\.md#([\w-]+)\) \| `([\w-]+)` \| (hand)? ?\|$", PAGE, re.M
    )
    assert rows == [
        (rule.sentence, rule.section, rule.name, "hand" if rule.by_hand else "") for rule in RULES
    ]
