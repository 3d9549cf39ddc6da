"""YAML from anywhere: what could hang, take all memory or end in a traceback is one sentence."""

import pytest

from limb_systems import EmulatedLimb, LimbParameters
from limb_systems.input import LARGEST_TEXT
from limb_systems.model.parameters import ParameterError
from limb_systems.schema import SchemaError, _parse

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, ["anchors and aliases", "line 1"]),
        ("format: 2\nboard: *there\n", ["anchors and aliases", "line 2"]),
        ("format: 2\nboard: &here {}\n", ["anchors and aliases", "line 2"]),
        ("format: !!int foo", ["tag 'tag:yaml.org,2002:int' is not read", "line 1"]),
        ("format: 2\n\nboard: !!bool foo", ["tag 'tag:yaml.org,2002:bool'", "line 3"]),
        ("board: !!binary eA==", ["tag 'tag:yaml.org,2002:binary'"]),
        ("board: !!timestamp 2001-01-01", ["tag 'tag:yaml.org,2002:timestamp'"]),
        ("%TAG ! tag:yaml.org,2002:\n---\nboard: !int foo", ["tag 'tag:yaml.org,2002:int'"]),
        ("board: !%1b[31m {}", [r"tag '!\x1b[31m' is not read"]),
        ("format: 2001-99-99", ["format '2001-99-99'"]),
        ("format: 0x_", ["format '0x_'"]),
        ("ambient_temperature: 1:30", ["ambient_temperature is '1:30'; it must be a number"]),
        (f"format: {'9' * 5000}", ["format '999", "..."]),
        (f"ambient_temperature: {'9' * 5000}", ["ambient_temperature is inf"]),
        (f"segments: [{{links: {'9' * 5000}}}]", ["links is '999", "...; it must be a whole"]),
        (f"%YAML 1.{'9' * 5000}\n---\n", ["4300 digits"]),
        ('board: "\\UFFFFFFFF"', ["not valid YAML", "line 1"]),
        ('format: 2\nboard: "\\U00110000"', ["not valid YAML", "line 2"]),
        ('board: "\\ud800"', [r"board.serial_number is '\ud800'; it must be one line"]),
        ('board: "\\e[31m"', [r"board.serial_number is '\x1b[31m'; it must be one line"]),
        ('board: !SerialBoard {serial_number: "a\\Lb"}', [r"board.serial_number is 'a\u2028b'"]),
        ("board: a\u202eb", [r"board.serial_number is 'a\u202eb'"]),
        ("? [a, b]\n: 1", ["['a', 'b'] is no name of a field", "line 1"]),
        ("5: 1", ["5 is no name of a field"]),
        ("? {a: 1}\n: 1", ["{'a': 1} is no name of a field"]),
        ("<<: {format: 2}", ["<< is not a known field"]),
        (f"{'x' * 900}: 1", ["'xxx", "... is not a known field"]),
        (f"board: [{'1, ' * 900}]", ["board must be one of", "1, ..."]),
        ("[" * 50_000, ["nested too deeply"]),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_no_document_ends_in_a_traceback(refused, text, words):
    with refused(ParameterError, *words):
        LimbParameters.from_yaml(text)


def test_many_fields_are_read_once_each(refused, monkeypatch):
    """As many as fit; a comparison of each with all others would take minutes."""
    text = "".join(f"f{number}: 1\n" for number in range(20_000))
    compared = []

    class Name(str):
        __slots__ = ()
        __hash__ = str.__hash__

        def __eq__(self, other):
            compared.append(other)
            return str.__eq__(self, other)

    monkeypatch.setattr(
        "limb_systems.schema._Loader.construct_scalar", lambda _, node: Name(node.value)
    )
    with refused(ParameterError, "f0 is not a known field"):
        LimbParameters.from_yaml(text)
    assert len(compared) < 50_000


def test_more_text_than_is_stated_is_neither_read_nor_written(refused):
    said = f"characters of YAML, but at most {LARGEST_TEXT} are read"
    with refused(ParameterError, said):
        LimbParameters.from_yaml("# " + "x" * LARGEST_TEXT)
    limb = LimbParameters(board=EmulatedLimb(0, "x" * LARGEST_TEXT))
    with refused(SchemaError, said):
        limb.to_yaml()


def test_values_have_the_type_of_their_looks():
    """As PyYAML's dumper quotes: what it writes bare is read as what it was."""
    looks = {
        "~": None,
        "null": None,
        "": None,
        "yes": True,
        "False": False,
        "-12": -12,
        "1.5": 1.5,
        "-1.0e-07": -1e-7,
        ".inf": float("inf"),
        "1e3": "1e3",
        "007": "007",
        "0x10": "0x10",
        "1_000": "1_000",
        "2001-01-01": "2001-01-01",
        "'12'": "12",
        "'null'": "null",
    }
    for text, value in looks.items():
        read = _parse(f"value: {text}")["value"]
        assert (type(read), read) == (type(value), value), text


def test_descriptions_have_lines_and_nothing_else_that_is_not_printed(refused):
    limb = LimbParameters(board=EmulatedLimb(1, LimbParameters().to_yaml(), ["hysteresis"]))
    assert LimbParameters.from_yaml(limb.to_yaml()) == limb
    limb.board.description = "a\x1bb"
    with refused(ParameterError, r"board.description is 'a\x1bb'"):
        limb.validate()
    limb.board = EmulatedLimb(1, absent=["two\nlines"])
    with refused(ParameterError, r"board.absent[0] is 'two\nlines'"):
        limb.validate()
