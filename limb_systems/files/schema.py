"""Typed dataclasses and their YAML: fields with units and ranges, tagged unions, plain errors.

The documents are those of `pydrake.common.yaml`: mappings for dataclasses, and
a tag such as ``!LinearLaw`` where there is a choice of classes. They are read
here, because `yaml_load_typed` has no ranges, does not know classes that are
defined later, and does not say where in the document a mistake is.
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
_NULLS = ("null", "~", "")
_SPECIAL = {".nan": "nan", ".inf": "inf", "-.inf": "-inf"}  # numbers that Python writes otherwise


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
    """A dataclass field with its unit and the closed range of values that are accepted.

    Args:
        default: a number, or a tuple of the numbers of a list; `dataclasses.MISSING` for none.
        meaning, prior: metadata of a field of a wire's law, see `WireLaw`.
        rare: whether files leave it out where it has its default, as of `rare`.
    """
    metadata = {"unit": unit, "range": (low, high), "rare": rare}
    metadata |= {"meaning": meaning, "prior": prior}
    if isinstance(default, tuple):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def rare(default: Any) -> Any:
    """A dataclass field that files leave out where it has its default: few limbs need it."""
    return dataclasses.field(default=default, metadata={"rare": True})


class Strict:
    """A dataclass that refuses to be given an attribute it has no field or property for."""

    def __setattr__(self, name: str, value: Any) -> None:
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        if name not in names and not isinstance(getattr(type(self), name, None), property):
            raise SchemaError(
                f"{type(self).__name__} has no field {name!r}{did_you_mean(name, names)}; it has "
                f"{', '.join(names)}."
            )
        super().__setattr__(name, value)


class Tagged(Strict):
    """A dataclass that is written to YAML with its name as the tag, as one of several choices."""


def dump_typed(value: Any) -> str:
    """YAML text of a dataclass, with all of its fields but rare ones, and every float exact.

    Raises:
        SchemaError: if `load_typed` would not read it: a text that cannot be
            printed, or more than is read.
    """
    text = yaml_dump(_plain(value))
    _check_size(text)
    return text


def load_typed(schema: type[T], text: str) -> T:
    """Reads YAML text into a dataclass.

    A field that is left out has its default; one without a default must be
    there. No field may be unknown. The metadata ``{"in_files": False}`` keep a field out of files,
    and a text in place of False is the field's name there. A class may have reasons, ``REFUSED``,
    for which it does not take fields that other programs have.

    A value has the type of its field, whatever it looks like. Texts are of one line
    of printable characters, or of several if the field has the metadata
    ``{"lines": True}``. There are no anchors or aliases, with which small documents
    can make huge values.

    Raises:
        SchemaError: with one sentence naming the field, or the line.
    """
    return _convert(_parse(text), schema, "")


def load_fields(schema: type, text: str) -> dict[str, Any]:
    """Reads YAML text as `load_typed` does, into the values of a dataclass's fields by their names.

    Raises:
        SchemaError: with one sentence naming the field, or the line.
    """
    return _field_values(_parse(text), schema, "", "the document")


def validate(target: Any, path: str = "") -> None:
    """Checks the types of a dataclass's fields, and its numbers against their ranges.

    Raises:
        SchemaError: for the first field that is wrong, with one sentence.
    """
    _convert(target, type(target), path)


def check_text(value: Any, name: str, metadata: typing.Mapping = _NO_METADATA) -> None:
    """Raises SchemaError unless it is text that can be printed anywhere; see `load_typed`."""
    if not isinstance(value, str):
        raise SchemaError(f"{name} is {short_repr(value)}; it must be text.")
    lines = value.split("\n") if metadata.get("lines") else [value]
    if not all(line.isprintable() for line in lines):
        raise SchemaError(f"{name} is {short_repr(value)}; it must be one line of printable text.")


def short_repr(value: Any) -> str:
    """Any value for an error: its ``repr``, the beginning of it if it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def _plain(value: Any, name: str = "", metadata: typing.Mapping = _NO_METADATA) -> Any:
    if dataclasses.is_dataclass(value):
        fields = [
            field
            for field in dataclasses.fields(value)
            if _name_in_files(field)
            and not (field.metadata.get("rare") and getattr(value, field.name) == field.default)
            and not (getattr(value, field.name) is field.default is None)
        ]
        plain = {
            _name_in_files(f): _plain(getattr(value, f.name), f.name, f.metadata) for f in fields
        }
        return {"_tag": f"!{type(value).__name__}", **plain} if isinstance(value, Tagged) else plain
    if isinstance(value, list | tuple):
        return [_plain(item, name, metadata) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item, name, metadata) for key, item in value.items()}
    if isinstance(value, str):
        check_text(value, name, metadata)
    return float(value) if isinstance(value, float) else value  # not numpy's


class _Loader(yaml.BaseLoader):
    """Keeps tags of classes; refuses what `load_typed` does, and fields that are given twice."""

    def compose_node(self, parent, index):
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise _problem("anchors and aliases (& and *) are not read", event)
        if event.tag and not re.fullmatch(r"!\w*", event.tag):
            raise _problem(f"the tag {short_repr(event.tag)} is not read", event)
        return super().compose_node(parent, index)

    def construct_mapping(self, node, deep=False):
        given = set()  # PyYAML would take the last one of two
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, str):
                raise _problem(f"{short_repr(name)} is no name of a field", key)
            if name in given:
                raise _problem(f"{short_repr(name)} is given twice", key)
            given.add(name)
        return super().construct_mapping(node, deep)


def _construct_tagged(loader: _Loader, tag: str, node: yaml.Node) -> dict:
    if not isinstance(node, yaml.MappingNode):
        raise _problem(f"!{tag} must have fields", node)
    return {"_tag": tag, **loader.construct_mapping(node, deep=True)}


_Loader.add_multi_constructor("!", _construct_tagged)


def _problem(what: str, part: yaml.Node | yaml.Event) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=what, problem_mark=part.start_mark)


def _check_size(text: str) -> None:
    if len(text) > LARGEST_TEXT:
        raise SchemaError(
            f"it has {len(text)} characters of YAML, but at most {LARGEST_TEXT} are read."
        )


def _parse(text: str) -> Any:
    """Lists, dicts and texts of a YAML document."""
    _check_size(text)
    try:
        loader = _Loader(text)
    except yaml.YAMLError as error:  # a character
        raise SchemaError(f"not valid YAML: {' '.join(str(error).split())}.") from error
    try:
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        what = " ".join(" ".join(filter(None, (error.context, error.problem))).split())
        line = error.problem_mark.line + 1 if error.problem_mark else loader.line + 1
        raise SchemaError(f"not valid YAML: {what} in line {line}.") from error
    except RecursionError as error:
        raise SchemaError("not valid YAML: it is nested too deeply.") from error
    except (ValueError, OverflowError) as error:  # an escape for a character that there is not
        raise SchemaError(f"not valid YAML: {error} in line {loader.line + 1}.") from error


def _convert(data: Any, schema: Any, path: str, metadata: typing.Mapping = _NO_METADATA) -> Any:
    """A value of a type, from lists, dicts and texts, or from such a value, which is checked."""
    schema = schema.registered() if hasattr(schema, "registered") else schema
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    where = path or "the document"
    if origin is tuple:
        if not isinstance(data, list | tuple) or len(data) != len(arguments):
            raise SchemaError(
                f"{where} must be a list of {len(arguments)}, but is {short_repr(data)}."
            )
        pairs = enumerate(zip(data, arguments, strict=True))
        return tuple(_convert(value, kind, f"{path}[{i}]", metadata) for i, (value, kind) in pairs)
    if origin is dict:
        if not isinstance(data, dict):
            raise SchemaError(f"{where} is {short_repr(data)}; it must have names with values.")
        for key in data:
            check_text(key, f"a name in {where}")
        named = ((key, value) for key, value in data.items() if key != "_tag")
        return {k: _convert(value, arguments[1], f"{path}.{k}", metadata) for k, value in named}
    if origin in (list, collections.abc.Sequence):
        if not isinstance(data, list):
            raise SchemaError(f"{where} is {short_repr(data)}; it must be a list.")
        items = enumerate(data)
        return [_convert(value, arguments[0], f"{path}[{i}]", metadata) for i, value in items]
    if origin in (typing.Union, types.UnionType):
        if type(None) in arguments and (data is None or data in _NULLS):
            return None
        plain = [choice for choice in arguments if choice is not type(None)]
        if len(plain) == 1 and not dataclasses.is_dataclass(plain[0]):
            return _convert(data, plain[0], path, metadata)
        schema = type(data) if isinstance(data, tuple(plain)) else _chosen_class(data, plain, where)
    if dataclasses.is_dataclass(schema):
        return _convert_fields(data, typing.cast(type, schema), path, where)
    if schema is str:
        check_text(data, path, metadata)
        return data
    if schema is bool:
        if data not in ("true", "false", True, False):
            raise SchemaError(f"{path} is {short_repr(data)}; it must be true or false.")
        return data in ("true", True)
    return _convert_number(data, schema, path, metadata)


def _convert_number(data: Any, schema: type, path: str, metadata: typing.Mapping) -> Any:
    number = _parse_number(data, schema) if isinstance(data, str) else data
    whole = isinstance(number, numbers.Integral) or (
        isinstance(data, str) and isinstance(number, float) and number.is_integer()
    )
    valid = isinstance(number, float) or whole
    valid &= (schema is float or whole) and not isinstance(number, bool)
    expected = "a whole number" if schema is int else "a number"
    if "range" in metadata:
        low, high = metadata["range"]
        valid = valid and low <= number <= high  # NaN is not
        expected += f" from {low:g} to {high:g} {metadata['unit']}".rstrip()
    if not valid:
        given = data if number is None else number
        raise SchemaError(f"{path} is {short_repr(given)}; it must be {expected}.")
    return schema(number) if isinstance(data, str) else number


def _parse_number(text: str, schema: type) -> int | float | None:
    try:
        if schema is int and re.fullmatch(r"[-+]?[0-9]+", text):  # those that no float has, too
            return int(text)
        return float(_SPECIAL.get(text, text))
    except ValueError:
        return None


def _name_in_files(field: dataclasses.Field) -> str:
    """The name of a field in files; empty if no file has it."""
    name = field.metadata.get("in_files", True)
    return name if isinstance(name, str) else field.name if name else ""


def _convert_fields(data: Any, schema: type, path: str, where: str) -> Any:
    values = _field_values(data, schema, path, where)
    return data if isinstance(data, schema) else schema(**values)


def _field_values(data: Any, schema: type, path: str, where: str) -> dict[str, Any]:
    """The values of a dataclass's fields by their names, without those that are left out."""
    hints, prefix = _hints(schema), f"{path}." if path else ""
    fields = {name: f for f in dataclasses.fields(schema) if (name := _name_in_files(f))}
    made = isinstance(data, schema)
    if not made and not isinstance(data, dict):
        raise SchemaError(
            f"{where} must have the fields {', '.join(fields)}, but is {short_repr(data)}."
        )
    if made:
        given = {name: getattr(data, field.name) for name, field in fields.items()}
    else:
        given = {key: value for key, value in data.items() if key != "_tag"}
    for key in given:
        if reason := getattr(schema, "REFUSED", {}).get(key):
            raise SchemaError(f"{prefix}{key} is refused: {reason}.")
        if key not in fields:
            unknown = f"{prefix}{key}" if key.isprintable() and len(key) < 80 else short_repr(key)
            raise SchemaError(
                f"{unknown} is not a known field{did_you_mean(key, list(fields))}; {where} has the "
                f"fields {', '.join(fields)}."
            )
    values = {}
    for key, field in fields.items():
        name, hint = f"{prefix}{key}", hints[field.name]
        if key in given:
            before = given[key]
            values[field.name] = after = _convert(before, hint, name, field.metadata)
            if made and after != before and after == after:  # a text is no number in an object
                kind = "a number" if hint in (int, float) else f"of the type {hint}"
                raise SchemaError(f"{name} is {short_repr(before)}; it must be {kind}.")
        elif field.default is field.default_factory is dataclasses.MISSING:
            raise SchemaError(f"{name} is missing.")
    return values


def _chosen_class(data: Any, given: list[type], where: str) -> type:
    """The class that is meant, of those that are given and all classes derived from them."""
    choices = {choice.__name__: choice for choice in _instantiable_subclasses(given)}
    tags = ", ".join(f"!{name}" for name in choices)
    if not isinstance(data, dict):
        raise SchemaError(f"{where} must be one of {tags}, but is {short_repr(data)}.")
    tag = data.get("_tag", given[0].__name__)
    if tag not in choices:
        raise SchemaError(
            f"{where} is a !{tag}, which is not known{did_you_mean(tag, list(choices))}; it must "
            f"be one of {tags}, or a class of your own whose module was imported "
            "(soft-limb --import MODULE ...)."
        )
    return choices[tag]


def _instantiable_subclasses(classes: list[type]) -> list[type]:
    found: list[type] = []
    for cls in classes:
        private = cls.__name__.startswith("_")
        if dataclasses.is_dataclass(cls) and not (private or inspect.isabstract(cls)):
            found.append(cls)
        found += _instantiable_subclasses(cls.__subclasses__())
    return found


@functools.cache
def _hints(schema: Any) -> dict[str, Any]:
    return typing.get_type_hints(schema)


def did_you_mean(name: str, names: collections.abc.Sequence[str]) -> str:
    """A hint at the known name that may be meant, for an error about an unknown one."""
    match = difflib.get_close_matches(name, names, n=1)
    return f" (did you mean {match[0]}?)" if match else ""
