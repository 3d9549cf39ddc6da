"""Typed dataclasses and their YAML: fields with units and ranges, tagged unions, plain errors.

The documents have the form of `pydrake.common.yaml`: mappings for dataclasses, and
a tag such as ``!LinearLaw`` where there is a choice of classes. They are read
here, because `yaml_load_typed` has no ranges, does not know classes that are
defined later, and does not name the place of a mistake in the document.
"""

import collections.abc
import dataclasses
import difflib
import functools
import inspect
import numbers
import re
import types
import typing
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump

from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TEXT

T = typing.TypeVar("T")
_NO_METADATA: typing.Mapping = types.MappingProxyType({})
_hints = functools.cache(typing.get_type_hints)  # of a dataclass's fields, by their names
_NULLS = ("null", "~", "")
_SPECIAL_NUMBERS = {".nan": "nan", ".inf": "inf", "-.inf": "-inf"}  # YAML's text, and Python's


class SchemaError(LimbError):
    """A YAML document does not have the fields it should have, or a value is out of its range."""


def quantity(
    default: Any,
    unit: str,
    low: float,
    high: float,
    meaning: str = "",
    prior: Any = None,
    *,
    rare: bool = False,
) -> Any:
    """Return a dataclass field with its unit and the closed range of accepted values.

    Args:
        default: a number, or a tuple of the numbers of a list; `dataclasses.MISSING` for none.
        meaning, prior: metadata of a field of a wire's law, see `WireLaw`.
        rare: whether files leave it out where it has its default, see `rare`.
    """
    metadata = {"unit": unit, "range": (low, high), "rare": rare}
    metadata |= {"meaning": meaning, "prior": prior}
    if isinstance(default, tuple):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def rare(default: Any) -> Any:
    """Return a dataclass field that files leave out where it has its default: few limbs need it."""
    return dataclasses.field(default=default, metadata={"rare": True})


def word(default: Any, words: collections.abc.Iterable, *, rare: bool = False) -> Any:
    """Return a dataclass field that has one of some words, or of some numbers.

    Args:
        words: the accepted words or numbers.
        rare: whether files leave it out where it has its default, see `rare`.
    """
    return dataclasses.field(default=default, metadata={"words": list(words), "rare": rare})


@functools.cache
def field_names(schema: type) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass."""
    return tuple(field.name for field in dataclasses.fields(schema))


class Strict:
    """A dataclass that refuses an attribute for which it has no field or property."""

    def __setattr__(self, name: str, value: Any) -> None:
        names = field_names(type(self))  # type: ignore[arg-type]
        if name not in names and not isinstance(getattr(type(self), name, None), property):
            raise SchemaError(
                f"{type(self).__name__} has no field {name!r}{did_you_mean(name, names)}; it has "
                f"{', '.join(names)}."
            )
        super().__setattr__(name, value)


class Tagged(Strict):
    """A dataclass that is written to YAML with its class name as the tag, as one of several."""


def dump_typed(value: Any) -> str:
    """Return the YAML text of a dataclass, with all fields but rare ones, and every float exact.

    Raises:
        SchemaError: if `load_typed` would not read it: a text that cannot be
            printed, or more than the largest size.
    """
    text = yaml_dump(_plain(value))
    _check_size(text)
    return text


def load_typed(schema: type[T], text: str) -> T:
    """Read YAML text into a dataclass.

    A missing field has its default; a field without a default must be
    there. No field may be unknown. The metadata ``{"in_files": False}`` keep a field out of files,
    and a text instead of False is the field's name there.

    A value has the type of its field, whatever it looks like. Texts are of one line
    of printable characters, or of several if the field has the metadata
    ``{"lines": True}``. There are no anchors or aliases, with which small documents
    can make huge values.

    Raises:
        SchemaError: with one sentence naming the field, or the line.
    """
    return _convert(_parse(text), schema, "")


def load_fields(schema: type, text: str) -> dict[str, Any]:
    """Read YAML text as `load_typed`, and return the values of a dataclass's fields by names.

    Raises:
        SchemaError: with one sentence naming the field, or the line.
    """
    return _field_values(_parse(text), schema, "", "the document")


def validate(target: Any, path: str = "") -> None:
    """Check the types of a dataclass's fields, and its numbers against their ranges.

    Raises:
        SchemaError: for the first field that is wrong, with one sentence.
    """
    _convert(target, type(target), path)


def check_text(value: Any, name: str, metadata: typing.Mapping = _NO_METADATA) -> None:
    """Raise SchemaError unless a value is text that can be printed anywhere; see `load_typed`."""
    if not isinstance(value, str):
        raise SchemaError(f"{name} is {short_repr(value)}; it must be text.")
    lines = value.split("\n") if metadata.get("lines") else [value]
    if not all(line.isprintable() for line in lines):
        raise SchemaError(f"{name} is {short_repr(value)}; it must be one line of printable text.")


def short_repr(value: Any) -> str:
    """Return the ``repr`` of a value for an error, shortened if it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def _plain(value: Any, name: str = "", metadata: typing.Mapping = _NO_METADATA) -> Any:
    """Return a value as lists, dicts, texts and numbers, as YAML takes them."""
    if dataclasses.is_dataclass(value):
        plain: dict[str, Any] = {}
        if isinstance(value, Tagged):
            plain["_tag"] = f"!{type(value).__name__}"
        for field in dataclasses.fields(value):
            field_value = getattr(value, field.name)
            name_in_files = _name_in_files(field)
            # Leave out rare fields with their defaults, and optional fields that are None.
            is_rare_default = field.metadata.get("rare") and field_value == field.default
            is_none = field_value is field.default is None
            if name_in_files and not is_rare_default and not is_none:
                plain[name_in_files] = _plain(field_value, field.name, field.metadata)
        return plain
    if isinstance(value, list | tuple):
        return [_plain(item, name, metadata) for item in value]
    if isinstance(value, str):
        check_text(value, name, metadata)
    return float(value) if isinstance(value, float) else value  # not numpy's


class _Loader(yaml.BaseLoader):
    """A YAML loader that keeps tags of classes, and refuses anchors and fields given twice."""

    def compose_node(self, parent, index):
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise _problem("anchors and aliases (& and *) are not read", event)
        if event.tag and not re.fullmatch(r"!\w*", event.tag):
            raise _problem(f"the tag {short_repr(event.tag)} is not read", event)
        return super().compose_node(parent, index)

    def construct_mapping(self, node, deep=False):
        names = set()  # PyYAML would take the last of two equal names
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, str):
                raise _problem(f"{short_repr(name)} is no name of a field", key)
            if name in names:
                raise _problem(f"{short_repr(name)} is given twice", key)
            names.add(name)
        return super().construct_mapping(node, deep)


def refuse_repeated_fields(text: str) -> None:
    """Raise yaml.YAMLError if a field of YAML text is given twice: other readers take the last."""
    yaml.load(text, _Loader)


def _construct_tagged(loader: _Loader, tag: str, node: yaml.Node) -> dict:
    """Return the fields of a tagged mapping, with the tag as ``_tag``."""
    if not isinstance(node, yaml.MappingNode):
        raise _problem(f"!{tag} must have fields", node)
    return {"_tag": tag, **loader.construct_mapping(node, deep=True)}


_Loader.add_multi_constructor("!", _construct_tagged)


def _problem(message: str, part: yaml.Node | yaml.Event) -> yaml.MarkedYAMLError:
    """Return an error about a part of a document."""
    return yaml.MarkedYAMLError(problem=message, problem_mark=part.start_mark)


def _check_size(text: str) -> None:
    """Raise SchemaError if a YAML text is larger than the largest size that is read."""
    if len(text) > LARGEST_TEXT:
        raise SchemaError(
            f"it has {len(text)} characters of YAML, but at most {LARGEST_TEXT} are read."
        )


def _parse(text: str) -> Any:
    """Return the lists, dicts and texts of a YAML document."""
    _check_size(text)
    try:
        loader = _Loader(text)
    except yaml.YAMLError as error:  # an invalid character
        raise SchemaError(f"not valid YAML: {' '.join(str(error).split())}.") from error
    try:
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        problem = " ".join(" ".join(filter(None, (error.context, error.problem))).split())
        line = error.problem_mark.line + 1 if error.problem_mark else loader.line + 1
        raise SchemaError(f"not valid YAML: {problem} in line {line}.") from error
    except RecursionError as error:
        raise SchemaError("not valid YAML: it is nested too deeply.") from error
    except (ValueError, OverflowError) as error:  # an escape that stands for no character
        raise SchemaError(f"not valid YAML: {error} in line {loader.line + 1}.") from error


def _convert(data: Any, schema: Any, path: str, metadata: typing.Mapping = _NO_METADATA) -> Any:
    """Convert lists, dicts and texts to a value of a type, or check such a value.

    Args:
        data: the parsed document, or a value of the type.
        schema: the type.
        path: place of the data in the document, for errors; empty for the whole.
        metadata: metadata of the dataclass field.
    """
    schema = schema.registered() if hasattr(schema, "registered") else schema
    origin = typing.get_origin(schema)
    arguments = typing.get_args(schema)
    where = path or "the document"
    # Convert the elements of collections.
    if origin is tuple:
        if not isinstance(data, list | tuple) or len(data) != len(arguments):
            raise SchemaError(
                f"{where} must be a list of {len(arguments)}, but is {short_repr(data)}."
            )
        pairs = enumerate(zip(data, arguments, strict=True))
        return tuple(_convert(value, kind, f"{path}[{i}]", metadata) for i, (value, kind) in pairs)
    if origin in (list, collections.abc.Sequence):
        if not isinstance(data, list):
            raise SchemaError(f"{where} is {short_repr(data)}; it must be a list.")
        items = enumerate(data)
        return [_convert(value, arguments[0], f"{path}[{i}]", metadata) for i, value in items]
    # Choose one type of a union.
    if origin in (typing.Union, types.UnionType):
        if type(None) in arguments and (data is None or data in _NULLS):
            return None
        choices = [choice for choice in arguments if choice is not type(None)]
        if len(choices) == 1 and not dataclasses.is_dataclass(choices[0]):
            return _convert(data, choices[0], path, metadata)
        is_made = isinstance(data, tuple(choices))
        schema = type(data) if is_made else _chosen_class(data, choices, where)
    # Convert a single value.
    if "words" in metadata:
        value = _parse_number(data, float) if schema is float and isinstance(data, str) else data
        if value not in metadata["words"]:
            words = ", ".join(map(str, metadata["words"]))
            raise SchemaError(f"{path} is {short_repr(data)}; it must be one of {words}.")
        return value
    if dataclasses.is_dataclass(schema):
        cls = typing.cast(type, schema)
        values = _field_values(data, cls, path, where)
        return data if isinstance(data, cls) else cls(**values)
    if schema is str:
        check_text(data, path, metadata)
        return data
    if schema is bool:
        if data not in ("true", "false", True, False):
            raise SchemaError(f"{path} is {short_repr(data)}; it must be true or false.")
        return data in ("true", True)
    return _convert_number(data, schema, path, metadata)


def _convert_number(data: Any, schema: type, path: str, metadata: typing.Mapping) -> Any:
    """Convert a text to a number of a type, or check a number; see `_convert`."""
    number = _parse_number(data, schema) if isinstance(data, str) else data
    # Check the type: a text such as 2.0 is a whole number, too.
    is_whole = isinstance(number, numbers.Integral) or (
        isinstance(data, str) and isinstance(number, float) and number.is_integer()
    )
    is_valid = isinstance(number, float) or is_whole
    is_valid &= (schema is float or is_whole) and not isinstance(number, bool)
    expected = "a whole number" if schema is int else "a number"
    # Check the range.
    if "range" in metadata:
        low, high = metadata["range"]
        is_valid = is_valid and low <= number <= high  # NaN is not
        expected += f" from {low:g} to {high:g} {metadata['unit']}".rstrip()
    if not is_valid:
        given = data if number is None else number
        raise SchemaError(f"{path} is {short_repr(given)}; it must be {expected}.")
    return schema(number) if isinstance(data, str) else number


def _parse_number(text: str, schema: type) -> int | float | None:
    """Return the number of a text; None if it is none."""
    try:
        # Whole numbers may have more digits than a float.
        if schema is int and re.fullmatch(r"[-+]?[0-9]+", text):
            return int(text)
        return float(_SPECIAL_NUMBERS.get(text, text))
    except ValueError:
        return None


def _name_in_files(field: dataclasses.Field) -> str:
    """Return the name of a field in files; empty if no file has it."""
    name = field.metadata.get("in_files", True)
    return name if isinstance(name, str) else field.name if name else ""


def _field_values(data: Any, schema: type, path: str, where: str) -> dict[str, Any]:
    """Return the values of a dataclass's fields by their names, without missing fields."""
    hints = _hints(schema)
    prefix = f"{path}." if path else ""
    fields = {}
    for field in dataclasses.fields(schema):
        if name_in_files := _name_in_files(field):
            fields[name_in_files] = field
    # Collect the values.
    is_made = isinstance(data, schema)
    if is_made:
        given = {name: getattr(data, field.name) for name, field in fields.items()}
    elif isinstance(data, dict):
        given = dict(data)
        given.pop("_tag", None)
    else:
        what = "empty" if data is None else short_repr(data)
        raise SchemaError(f"{where} must have the fields {', '.join(fields)}, but is {what}.")
    # Refuse unknown fields.
    for key in given:
        if key not in fields:
            is_printable = key.isprintable() and len(key) < 80
            unknown = f"{prefix}{key}" if is_printable else short_repr(key)
            raise SchemaError(
                f"{unknown} is not a known field{did_you_mean(key, list(fields))}; {where} has the "
                f"fields {', '.join(fields)}."
            )
    # Convert the values.
    values = {}
    for key, field in fields.items():
        name = f"{prefix}{key}"
        hint = hints[field.name]
        if key in given:
            value = given[key]
            converted = _convert(value, hint, name, field.metadata)
            values[field.name] = converted
            # In an object a text is no number. NaN differs from itself.
            if is_made and converted != value and converted == converted:
                kind = "a number" if hint in (int, float) else f"of the type {hint}"
                raise SchemaError(f"{name} is {short_repr(value)}; it must be {kind}.")
        elif field.default is field.default_factory is dataclasses.MISSING:
            raise SchemaError(f"{name} is missing.")
    return values


def _chosen_class(data: Any, given: list[type], where: str) -> type:
    """Return the class that the tag names, of the given classes and their subclasses."""
    choices = {choice.__name__: choice for choice in _instantiable_subclasses(given)}
    tags = ", ".join(f"!{name}" for name in choices)
    if not isinstance(data, dict):
        raise SchemaError(f"{where} must be one of {tags}, but is {short_repr(data)}.")
    # The first class is the default.
    tag = data.get("_tag", given[0].__name__)
    if tag not in choices:
        raise SchemaError(
            f"{where} is a !{tag}, which is not known{did_you_mean(tag, list(choices))}; it must "
            f"be one of {tags}, or a class of your own whose module was imported "
            "(soft-limb --import MODULE ...)."
        )
    return choices[tag]


def _instantiable_subclasses(classes: list[type]) -> list[type]:
    """Return the public dataclasses that are not abstract, of classes and their subclasses."""
    instantiable: list[type] = []
    for cls in classes:
        is_private = cls.__name__.startswith("_")
        if dataclasses.is_dataclass(cls) and not (is_private or inspect.isabstract(cls)):
            instantiable.append(cls)
        instantiable += _instantiable_subclasses(cls.__subclasses__())
    return instantiable


def did_you_mean(name: str, names: collections.abc.Sequence[str]) -> str:
    """Return a hint at the known name that is most like an unknown one; empty if there is none."""
    match = difflib.get_close_matches(name, names, n=1)
    return f" (did you mean {match[0]}?)" if match else ""
