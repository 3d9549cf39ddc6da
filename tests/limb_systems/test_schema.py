"""YAML from anywhere: what could hang, take all memory or end in a traceback is one sentence."""

from limb_systems import EmulatedLimb, LimbParameters
from limb_systems.files.input import LARGEST_TEXT
from limb_systems.files.schema import SchemaError
from limb_systems.limb_parameters import ParameterError

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


DOCUMENTS = [
    (BOMB, ["anchors and aliases", "line 1"]),
    ("format: 2\nboard: *there\n", ["anchors and aliases", "line 2"]),
    ("format: 2\n\nboard: !!bool foo", ["tag 'tag:yaml.org,2002:bool' is not read", "line 3"]),
    ("%TAG ! tag:yaml.org,2002:\n---\nboard: !int foo", ["tag 'tag:yaml.org,2002:int'"]),
    ("board: !%1b[31m {}", [r"tag '!\x1b[31m' is not read"]),
    ("format: 2001-99-99", ["format is '2001-99-99'; it must be a whole number"]),
    ("ambient_temperature: 1:30", ["ambient_temperature is '1:30'; it must be a number"]),
    (f"ambient_temperature: {'9' * 5000}", ["ambient_temperature is inf"]),
    ("segments: [{links: .inf}]", ["links is inf; it must be a whole number from 1"]),
    (f"%YAML 1.{'9' * 5000}\n---\n", ["4300 digits"]),
    ('board: "\\UFFFFFFFF"', ["not valid YAML", "line 1"]),
    ('board: "\\ud800"', [r"board must be one of", r"but is '\ud800'"]),
    ('board: !SerialBoard {serial_number: "a\\e[31m"}', [r"serial_number is 'a\x1b[31m'; it must"]),
    ("board: !SerialBoard {serial_number: a\u202eb}", [r"board.serial_number is 'a\u202eb'"]),
    ("? [a, b]\n: 1", ["['a', 'b'] is no name of a field", "line 1"]),
    ("<<: {format: 2}", ["<< is not a known field"]),
    (f"{'x' * 900}: 1", ["'xxx", "... is not a known field"]),
    (f"board: [{'1, ' * 900}]", ["board must be one of", "'1', '...."]),
    ("[" * 5000, ["nested too deeply"]),
]


def test_no_document_ends_in_a_traceback(refused):
    for text, words in DOCUMENTS:
        with refused(ParameterError, *words):
            LimbParameters.from_yaml(text)


def test_more_text_than_is_stated_is_neither_read_nor_written(refused):
    said = f"characters of YAML, but at most {LARGEST_TEXT} are read"
    with refused(ParameterError, said):
        LimbParameters.from_yaml("# " + "x" * LARGEST_TEXT)
    limb = LimbParameters(board=EmulatedLimb(0, "x" * LARGEST_TEXT))
    with refused(SchemaError, said):
        limb.to_yaml()
