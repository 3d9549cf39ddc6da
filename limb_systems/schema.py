"""YAML into typed dataclasses, with errors that say which field and why."""

import dataclasses
import typing

import yaml
from pydrake.common.yaml import yaml_load_typed

from limb_systems.errors import LimbError

T = typing.TypeVar("T")


class SchemaError(LimbError):
    """A YAML document does not have the fields it should have."""


def load_typed(schema: type[T], text: str) -> T:
    """Reads YAML text into a dataclass; every field must be there, none unknown.

    `yaml_load_typed` refuses the same documents without saying where the
    trouble is, so the structure is compared first.

    Raises:
        SchemaError: with one sentence naming the field.
    """
    try:
        data = yaml.load(text, Loader=_StrictLoader)
    except yaml.YAMLError as error:
        raise SchemaError(f"not valid YAML: {' '.join(str(error).split())}.") from error
    except RecursionError as error:
        raise SchemaError("not valid YAML: it is nested too deeply.") from error
    _check_structure(data, schema, "")
    return yaml_load_typed(schema=schema, data=text, allow_schema_with_no_yaml=False)


class _StrictLoader(yaml.SafeLoader):
    """Refuses fields that are given twice, of which PyYAML takes the last."""

    def construct_mapping(self, node, deep=False):
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for index, key in enumerate(keys):
            if key in keys[:index]:
                raise yaml.MarkedYAMLError(
                    problem=f"{key!r} is given twice", problem_mark=node.value[index][0].start_mark
                )
        return super().construct_mapping(node, deep)


def _check_structure(data, schema, path: str) -> None:
    where = path or "the document"
    if typing.get_origin(schema) is list:
        if not isinstance(data, list):
            raise SchemaError(f"{where} must be a list, but is {data!r}.")
        for index, item in enumerate(data):
            _check_structure(item, typing.get_args(schema)[0], f"{path}[{index}]")
    elif dataclasses.is_dataclass(schema):
        _check_fields(data, schema, path, where)
    elif schema is str:
        if not isinstance(data, str):
            raise SchemaError(f"{path} is {data!r}; it must be text.")
    elif not _is_number(data, schema):
        kind = "a whole number" if schema is int else "a number"
        raise SchemaError(f"{path} is {data!r}; it must be {kind}.")


def _check_fields(data, schema, path: str, where: str) -> None:
    fields = dataclasses.fields(schema)
    names = [field.name for field in fields]
    if not isinstance(data, dict):
        raise SchemaError(f"{where} must have the fields {', '.join(names)}, but is {data!r}.")
    prefix = f"{path}." if path else ""
    for key in data:
        if key not in names:
            unknown = f"{prefix}{key}" if str(key).isprintable() else repr(key)
            raise SchemaError(
                f"{unknown} is not a known field; {where} has the fields {', '.join(names)}."
            )
    for field in fields:
        if field.name not in data:
            raise SchemaError(f"{prefix}{field.name} is missing.")
        _check_structure(data[field.name], field.type, f"{prefix}{field.name}")


def _is_number(data, schema) -> bool:
    """Whether pydrake converts it: numbers, and text that Python reads as such."""
    if isinstance(data, bool):
        return False
    if isinstance(data, str):  # what PyYAML makes of 1e-3, without a dot
        try:
            schema(data)
        except ValueError:
            return False
        return True
    if schema is int:
        return isinstance(data, int) or (isinstance(data, float) and data.is_integer())
    return isinstance(data, float) or (isinstance(data, int) and abs(data) < 10**300)
