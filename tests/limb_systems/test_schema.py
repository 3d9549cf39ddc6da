"""YAML from anywhere: what could hang, take all memory or end in a traceback is one sentence."""

import dataclasses
import math

from limb_systems import EmulatedLimb, LimbParameters
from limb_systems.input import LARGEST_TEXT
from limb_systems.model.parameters import ParameterError
from limb_systems.schema import SchemaError, dump_typed, load_typed, validate

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


DOCUMENTS = [
    (BOMB, ["anchors and aliases", "line 1"]),
    ("format: 2\nboard: *there\n", ["anchors and aliases", "line 2"]),
    ("format: 2\nboard: &here {}\n", ["anchors and aliases", "line 2"]),
    ("format: 2\n\nboard: !!bool foo", ["tag 'tag:yaml.org,2002:bool' is not read", "line 3"]),
    ("%TAG ! tag:yaml.org,2002:\n---\nboard: !int foo", ["tag 'tag:yaml.org,2002:int'"]),
    ("board: !%1b[31m {}", [r"tag '!\x1b[31m' is not read"]),
    ("format: 2001-99-99", ["format is '2001-99-99'; it must be a whole number"]),
    ("format: 0x_", ["format is '0x_'"]),
    ("ambient_temperature: 1:30", ["ambient_temperature is '1:30'; it must be a number"]),
    ("ambient_temperature: 0x10", ["ambient_temperature is '0x10'; it must be a number"]),
    ("ambient_temperature: yes", ["ambient_temperature is 'yes'; it must be a number"]),
    (f"ambient_temperature: {'9' * 5000}", ["ambient_temperature is inf"]),
    (f"segments: [{{links: {'9' * 5000}}}]", ["links is '999", "...; it must be a whole"]),
    ("segments: [{links: .inf}]", ["links is inf; it must be a whole number from 1"]),
    (f"%YAML 1.{'9' * 5000}\n---\n", ["4300 digits"]),
    ('board: "\\UFFFFFFFF"', ["not valid YAML", "line 1"]),
    ('format: 2\nboard: "\\U00110000"', ["not valid YAML", "line 2"]),
    ('board: "\\ud800"', [r"board must be one of", r"but is '\ud800'"]),
    ('board: !SerialBoard {serial_number: "a\\e[31m"}', [r"serial_number is 'a\x1b[31m'; it must"]),
    ("board: !SerialBoard {serial_number: a\u202eb}", [r"board.serial_number is 'a\u202eb'"]),
    ("? [a, b]\n: 1", ["['a', 'b'] is no name of a field", "line 1"]),
    ("5: 1", ["5 is not a known field"]),
    ("<<: {format: 2}", ["<< is not a known field"]),
    (f"{'x' * 900}: 1", ["'xxx", "... is not a known field"]),
    (f"board: [{'1, ' * 900}]", ["board must be one of", "'1', '...."]),
    ("[" * 5000, ["nested too deeply"]),
]


def test_no_document_ends_in_a_traceback(refused):
    for text, words in DOCUMENTS:
        with refused(ParameterError, *words):
            LimbParameters.from_yaml(text)


def test_many_fields_are_read_once_each(refused, monkeypatch):
    """As many as fit; a comparison of each with all others would take minutes."""
    text = "".join(f"f{number}: 1\n" for number in range(2000))
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
    assert len(compared) < 5000


def test_more_text_than_is_stated_is_neither_read_nor_written(refused):
    said = f"characters of YAML, but at most {LARGEST_TEXT} are read"
    with refused(ParameterError, said):
        LimbParameters.from_yaml("# " + "x" * LARGEST_TEXT)
    limb = LimbParameters(board=EmulatedLimb(0, "x" * LARGEST_TEXT))
    with refused(SchemaError, said):
        limb.to_yaml()


@dataclasses.dataclass
class Fields:
    text: str = ""
    number: float = 0.0
    count: int = 0
    choice: bool = False
    other: int | None = 0


def test_values_have_the_type_of_their_field():
    looks = [
        ("text", "007", "007"),
        ("text", "null", "null"),
        ("text", "2001-01-01", "2001-01-01"),
        ("text", "'yes'", "yes"),
        ("number", "1e3", 1000.0),
        ("number", "-1.0e-07", -1e-7),
        ("number", "-.inf", -math.inf),
        ("number", "'12'", 12.0),
        ("count", "-12", -12),
        ("count", "5.0", 5),
        ("count", str(2**80 + 1), 2**80 + 1),
        ("choice", "true", True),
        ("other", "null", None),
        ("other", "", None),
        ("other", "3", 3),
    ]
    for name, text, value in looks:
        read = getattr(load_typed(Fields, f"{name}: {text}"), name)
        assert (type(read), read) == (type(value), value), text
    assert math.isnan(load_typed(Fields, "number: .nan").number)
    made = Fields(text="~", number=math.inf, count=-1, choice=True, other=None)
    assert load_typed(Fields, dump_typed(made)) == made


def test_what_files_hold_as_text_is_no_value_of_an_object(refused):
    for name, value in (("count", "3"), ("number", "1.5"), ("choice", "true"), ("other", "null")):
        with refused(SchemaError, f"{name} is {value!r}; it must be"):
            validate(Fields(**{name: value}))
    limb = LimbParameters()
    limb.segments[0].rest_memory = {"shift": 0.1}
    with refused(ParameterError, "segments[0].rest_memory is {'shift': 0.1}"):
        limb.validate()
    validate(Fields(number=math.nan, other=None))


def test_descriptions_have_lines_and_nothing_else_that_is_not_printed(refused):
    limb = LimbParameters(board=EmulatedLimb(1, LimbParameters().to_yaml(), ["hysteresis"]))
    assert LimbParameters.from_yaml(limb.to_yaml()) == limb
    limb.board.description = "a\x1bb"
    with refused(ParameterError, r"board.description is 'a\x1bb'"):
        limb.validate()
    limb.board = EmulatedLimb(1, absent=["two\nlines"])
    with refused(ParameterError, r"board.absent[0] is 'two\nlines'"):
        limb.validate()
